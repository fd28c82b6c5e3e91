// The bundle: two pages, the viewer and the description of the interface, each with its script and sheet, all from the server
// that serves them.
import { readFileSync } from 'node:fs';
import { defineConfig, type Plugin } from 'vite';

// Swagger UI comes as one file with packages of others in it; their licences stand beside it.
const swaggerLicenses: Plugin = {
  name: 'swagger-licenses',
  generateBundle() {
    const source = readFileSync('node_modules/swagger-ui-dist/swagger-ui-es-bundle.js.LICENSE.txt', 'utf8');
    this.emitFile({ type: 'asset', fileName: 'licenses-swagger-ui.md', source });
  },
};

export default defineConfig({
  // The page is at `/`, all that belongs to it below `/viewer/`.
  base: '/viewer/',
  plugins: [swaggerLicenses],
  build: {
    outDir: 'prebuilt',
    emptyOutDir: true,
    // Nothing as a data: address; the page's policy takes files of the server alone.
    assetsInlineLimit: 0,
    // Names below this folder hold a hash of the contents: the server lets them be kept for ever.
    assetsDir: 'assets',
    license: { fileName: 'licenses.md' },
    modulePreload: false,
    target: 'es2022',
    // Swagger UI is one piece of 1.7 MB.
    chunkSizeWarningLimit: 2000,
    rolldownOptions: { input: ['index.html', 'docs.html'] },
  },
  server: {
    // A running `ubbmap demo`; VIEWER_SERVER names another server.
    proxy: { '/v1': process.env.VIEWER_SERVER ?? 'http://127.0.0.1:8080' },
  },
});
