// The bundle: one page, one script, one sheet, all from the server that serves them.
import { defineConfig } from 'vite';

export default defineConfig({
  // The page is at `/`, all that belongs to it below `/viewer/`.
  base: '/viewer/',
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
    chunkSizeWarningLimit: 600,
  },
  server: {
    // A running `ubbmap demo`; VIEWER_SERVER names another server.
    proxy: { '/v1': process.env.VIEWER_SERVER ?? 'http://127.0.0.1:8080' },
  },
});
