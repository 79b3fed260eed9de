// A user's day with cncjs: its server in this process, driven through its socket as by its pages.
//
//     node drive_cncjs.js CNCJS_FOLDER PLAN_FILE RESULT_FILE HTTP_PORT

'use strict';

const fs = require('fs');
const path = require('path');

const [home, planFile, resultFile, httpPort] = process.argv.slice(2);
const plan = JSON.parse(fs.readFileSync(planFile));
const from = (name) => require(require.resolve(name, { paths: [home] }));
const server = path.join(home, 'dist', 'cncjs');
const result = { unparsed: [], errors: [], override: [], states: [] };
const settingsFile = path.join(path.dirname(resultFile), 'cncrc');
const secret = 'for this test';
const patienceMs = 60000;

// Lines that its parser does not recognise would appear as noise.
const { default: Parser } = require(path.join(server, 'server/controllers/Grbl/GrblLineParser'));
const parse = Parser.prototype.parse;
Parser.prototype.parse = function (line) {
  const parsed = parse.call(this, line);
  if (!parsed.type) result.unparsed.push(line);
  return parsed;
};

function finish(error) {
  if (error) result.failed = String(error.stack || error);
  fs.writeFileSync(resultFile, JSON.stringify(result));
  process.exit(0);
}

function connect() {
  const jwt = from('jsonwebtoken');
  const io = from('socket.io-client');
  const token = jwt.sign({ id: '', name: '' }, secret);
  return io(`http://127.0.0.1:${httpPort}`, { query: `token=${token}`, reconnection: true });
}

function watch(socket) {
  const seen = { state: {}, settings: {}, workflow: '', sender: {} };
  socket.on('controller:state', (kind, state) => {
    seen.kind = kind;
    seen.state = state;
    const status = state.status || {};
    if (status.ov && status.ov.length) result.override.push(Number(status.ov[0]));
    if (result.states[result.states.length - 1] !== status.activeState) {
      result.states.push(status.activeState);
    }
  });
  socket.on('controller:settings', (kind, settings) => { seen.settings = settings; });
  socket.on('workflow:state', (state) => { seen.workflow = state; });
  socket.on('sender:status', (status) => { seen.sender = status; });
  socket.on('serialport:read', (line) => {
    if (/^(error|ALARM)/.test(line)) result.errors.push(line);
  });
  return seen;
}

async function until(what, condition) {
  const end = Date.now() + patienceMs;
  while (!condition()) {
    if (Date.now() > end) throw new Error(`never ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
}

const numbers = (place) => ['x', 'y', 'z'].map((axis) => Number(place[axis]));

async function day(socket) {
  const seen = watch(socket);
  const command = (...words) => socket.emit('command', plan.port, ...words);
  const status = () => (seen.state.status || {});
  const at = (expected) => {
    const place = status().mpos ? numbers(status().mpos) : [];
    return status().activeState === 'Idle' && place.every((mm, i) => Math.abs(mm - expected[i]) < 0.005);
  };

  await until('connected', () => socket.connected);
  socket.emit('open', plan.port, { controllerType: 'Grbl', baudrate: 115200 });
  await until('ready', () => Object.keys(seen.settings.settings || {}).length >= 34);
  result.controller = seen.kind || 'Grbl';
  await until('locked', () => status().activeState === 'Alarm');

  command('homing');
  await until('homed', () => at(plan.homed));
  result.homed = numbers(status().mpos);
  command('gcode', plan.jog);
  await until('jogged', () => at(plan.jogged));
  command('gcode', plan.zero);
  await until('zeroed', () => status().wpos && numbers(status().wpos).every((mm) => mm === 0));
  result.zeroed = numbers(status().wpos);

  command('gcode:load', 'day.nc', plan.program.join('\n') + '\n');
  await until('loaded', () => seen.sender.total > 0);
  command('gcode:start');
  await until('running', () => status().activeState === 'Run' && seen.sender.received > 3);
  for (const percent of [110, 120]) {
    command('feedOverride', 10);
    await until('overridden', () => result.override.includes(percent));
  }
  command('gcode:pause');
  await until('held', () => status().activeState === 'Hold' && status().subState === 0);
  result.held = numbers(status().mpos);
  command('gcode:resume');
  await until('resumed', () => status().activeState === 'Run');
  await until('done', () => at(plan.ended) && seen.sender.received === seen.sender.total);
  result.mpos = numbers(status().mpos);
  result.wpos = numbers(status().wpos);
  result.settings = Object.fromEntries(
    Object.entries(seen.settings.settings).map(([name, value]) => [name.replace('$', ''), value])
  );
  // The version it uses, from the banner or from its own query.
  result.version = seen.settings.version;
}

process.argv = ['node', 'cncjs', '--host', '127.0.0.1', '--port', httpPort, '--config', settingsFile];
fs.writeFileSync(settingsFile, JSON.stringify({ secret, checkForUpdates: false }));
process.on('unhandledRejection', finish);
const launch = require(path.join(server, 'server-cli'));
(launch.default || launch)()
  .then(() => day(connect()))
  .then(() => finish())
  .catch(finish);
