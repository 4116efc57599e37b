// A page in headless Chromium follows a moving view by gRPC-web while a survey arrives.
//
//   npm install && node follow.mjs [PROGRAM]      (PROGRAM: the terraquilt to try; else ../../target/release/terraquilt)
//
// Makes a database of bundled surveys, serves it with a token for the page's origin, opens the page (page.mjs), lets its camera
// move, ingests another survey meanwhile by the command line, and prints what the page saw. Exit 1 if a difference did not fit,
// a hash differed, the last question was not answered, or the arrival did not show. Chromium: $CHROMIUM, or `chromium` in $PATH.

import { execFileSync, spawn } from 'node:child_process';
import { createServer } from 'node:http';
import { existsSync, mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { dirname, extname, join, normalize, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';
import { chromium } from 'playwright-core';

const here = dirname(fileURLToPath(import.meta.url));
const root = resolve(here, '../..');
const program = resolve(process.argv[2] ?? join(root, 'target/release/terraquilt'));
const data = join(root, 'tests/data/st_helens');
const browserPath =
  process.env.CHROMIUM ?? ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find(existsSync);
const STEPS = 120;
const EVERY_MS = 50;

const run = (...args) => execFileSync(program, args, { encoding: 'utf8', stdio: ['ignore', 'pipe', 'inherit'] });

/// The page and what it loads: this folder, and proto/.
function pages() {
  const kinds = { '.html': 'text/html', '.mjs': 'text/javascript', '.js': 'text/javascript', '.proto': 'text/plain' };
  return createServer((request, response) => {
    const path = normalize(new URL(request.url, 'http://page').pathname);
    const file = path.startsWith('/proto/') ? join(root, path) : join(here, path === '/' ? 'page.html' : path);
    if (!existsSync(file) || !kinds[extname(file)]) {
      response.writeHead(404).end();
      return;
    }
    response.writeHead(200, { 'content-type': `${kinds[extname(file)]}; charset=utf-8` }).end(readFileSync(file));
  });
}

/// Starts the server and returns its address once it listens.
function serve(db, origin) {
  const child = spawn(program, ['serve', db, '--listen', '127.0.0.1:0', '--allow-origin', origin, '--log-level', 'warn']);
  const address = new Promise((found, failed) => {
    let said = '';
    child.stderr.on('data', (bytes) => {
      said += bytes;
      const at = said.match(/listens on (http:\/\/\S+)/);
      if (at) found(at[1]);
    });
    child.on('exit', () => failed(new Error(`the server ended: ${said}`)));
  });
  return { child, address };
}

const folder = mkdtempSync(join(tmpdir(), 'terraquilt-browser-'));
const page = pages();
let server;
let browser;
try {
  const db = join(folder, 'hills');
  run('init', db, '--crs', 'EPSG:26910', '--policy', 'newest');
  run('ingest', db, join(data, 'survey_2000-09-25_native.tif'), '--accuracy', '2', '--date', '2000-09-25');
  const token = run('token', 'add', db, '--right', 'read', '--name', 'page').trim();
  await new Promise((listening) => page.listen(0, '127.0.0.1', listening));
  const origin = `http://127.0.0.1:${page.address().port}`;
  server = serve(db, origin);
  const address = await server.address;
  const [x0, y0, x1, y1] = JSON.parse(run('surveys', db, '--json'))[0].bounds;
  const at = (u, v) => [x0 + u * (x1 - x0), y0 + v * (y1 - y0), 3500];
  const path = { from: at(0.2, 0.1), to: at(0.7, 0.3), look: [0, 0.4 * (y1 - y0), -1800], pixels: 1 };

  browser = await chromium.launch({ executablePath: browserPath, args: ['--no-sandbox', '--disable-gpu'] });
  const tab = await browser.newPage();
  tab.on('pageerror', (e) => console.error(`page: ${e}`));
  tab.on('console', (m) => m.type() === 'error' && console.error(`page: ${m.text()}`));
  await tab.goto(origin);
  await tab.waitForFunction(() => window.ready);
  const moved = tab.evaluate((o) => window.follow(o), { server: address, token, steps: STEPS, every: EVERY_MS, path });
  await tab.waitForFunction(() => window.seen?.newest >= 20 || window.seen?.problem, null, { timeout: 60_000 });
  const arriving = spawn(program, [
    'ingest', db, join(data, 'survey_2004-10-13_native.tif'), '--accuracy', '0.5', '--date', '2004-10-13', '--json',
  ], { stdio: ['ignore', 'ignore', 'inherit'] });
  const arrived = new Promise((done) => arriving.on('exit', done));
  await moved;
  if ((await arrived) !== 0) throw new Error('the survey could not be ingested');
  const last = (s) => window.seen.problem || (window.seen.newest >= s && window.seen.differences.at(-1).version >= 2);
  await tab.waitForFunction(last, STEPS, { timeout: 60_000 });
  const seen = await tab.evaluate(() => ({
    problem: window.seen.problem, newest: window.seen.newest, steers: window.seen.steers, differences: window.seen.differences,
  }));
  await tab.evaluate(() => window.seen.stop());
  if (seen.problem) throw new Error(seen.problem);
  const sum = (field, of = seen.differences) => of.reduce((n, d) => n + d[field], 0);
  const ofVersion2 = seen.differences.filter((d) => d.version >= 2);
  const end = seen.differences.at(-1);
  console.log(JSON.stringify({
    browser: await browser.version(),
    steers: seen.steers,
    differences: seen.differences.length,
    hashes_equal: seen.differences.length,
    added: sum('added'), removed: sum('removed'), changed: sum('changed'), payload_bytes: sum('bytes'),
    unasked: seen.differences.filter((d) => d.answers === 0).length,
    first_of_version_2: ofVersion2[0],
    last: end,
  }, null, 1));
  const shown = seen.differences.some((d) => d.answers === 0 && d.version >= 2 && d.added > 0 && d.surveys.length === 2);
  if (!shown) throw new Error('the arrival did not show in the view');
  if (seen.steers !== STEPS) throw new Error(`${seen.steers} of ${STEPS} steps were taken`);
} finally {
  await browser?.close();
  server?.child.removeAllListeners('exit');
  server?.child.kill('SIGTERM');
  page.close();
  rmSync(folder, { recursive: true, force: true });
}
