// A server of the release binary on a directory of its own, and what the tests ask it directly: the page is held to these answers.

import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

const ROOT = fileURLToPath(new URL('../..', import.meta.url));
export const BINARY = process.env.VIEWER_BINARY ?? path.join(ROOT, 'target/release/ubbmap');

export class Server {
  constructor() {
    this.folder = mkdtempSync(path.join(tmpdir(), 'ubbmap-viewer-'));
    this.listen = '127.0.0.1:0';
  }

  async start() {
    const data = path.join(this.folder, 'data');
    const environment = { ...process.env, UBBMAP_LOG: 'warn' };
    this.process = spawn(BINARY, ['serve', '--listen', this.listen, '--data', data], { env: environment });
    this.log = '';
    this.process.stderr.on('data', (bytes) => (this.log += bytes));
    this.ended = new Promise((done) => this.process.on('exit', (code) => done(code)));
    const line = await new Promise((done, failed) => {
      this.process.stdout.once('data', (bytes) => done(String(bytes)));
      this.process.once('error', failed);
      this.process.once('exit', () => failed(new Error(`the server ended: ${this.log}`)));
    });
    this.url = /http:\/\/[0-9.:]+/.exec(line)[0];
    // Started again it is where the page looks for it.
    this.listen = this.url.replace('http://', '');
    return this;
  }

  /** Ends in peace, and without a word in the log. */
  async stop() {
    this.process.kill('SIGTERM');
    const code = await this.ended;
    if (code !== 0 || this.log !== '') throw new Error(`the server ended with ${code}: ${this.log}`);
  }

  remove() {
    rmSync(this.folder, { recursive: true, force: true });
  }

  async ask(method, at, body) {
    const headers = { accept: 'application/json', 'content-type': 'application/json' };
    const response = await fetch(this.url + at, { method, headers, body: body && JSON.stringify(body) });
    const text = await response.text();
    return { status: response.status, json: text === '' ? null : JSON.parse(text) };
  }

  async get(at) {
    const { status, json } = await this.ask('GET', at);
    if (status !== 200) throw new Error(`${at}: ${status} ${JSON.stringify(json)}`);
    return json;
  }

  async create(map, config) {
    const { status, json } = await this.ask('PUT', `/v1/maps/${map}`, config);
    if (status !== 201) throw new Error(JSON.stringify(json));
  }

  async insert(map, scans) {
    const { json } = await this.ask('POST', `/v1/maps/${map}/scans`, { scans });
    if (json.applied !== scans.length) throw new Error(JSON.stringify(json));
    return json.revision;
  }

  async classes(map, points, depth, snapshot = '') {
    const { json } = await this.ask('POST', `/v1/maps/${map}/classes`, { points, depth, snapshot });
    return json.classes;
  }

  /** The leaf that holds a point. */
  async leaf(map, x, y) {
    const { bounds, config } = await this.get(`/v1/maps/${map}`);
    const { leaves } = await this.get(`/v1/maps/${map}/region?min_x=${x}&min_y=${y}&max_x=${x + 1e-4}&max_y=${y + 1e-4}`);
    const side = config.resolution * 2 ** config.depth;
    return leaves.find((leaf) => {
      const size = side / 2 ** leaf.depth;
      const [left, bottom] = [bounds.min_x + leaf.x * size, bounds.min_y + leaf.y * size];
      return x >= left && x < left + size && y >= bottom && y < bottom + size;
    });
  }

  async free(map, region, tolerance = 0) {
    const { json } = await this.ask('POST', `/v1/maps/${map}/guaranteed-free`, { regions: [region], tolerance });
    return { ...json.results[0], sound: json.sound };
  }
}
