// Motion: the clock that plays and rotates, and the glide from one view to another.
const clock = { last: 0, spare: 0, runs: false, glide: null };

function tick(now) {
  const seconds = Math.min(0.1, (now - clock.last) / 1000), frames = clipNow().frames.length;
  clock.last = now;
  if (state.playing) {
    clock.spare += seconds * (meta.fps || 25) * state.speed;
    const steps = Math.floor(clock.spare);
    clock.spare -= steps;
    if (steps) go((state.moment + steps) % frames);
  }
  if (state.spin) { state.yaw += 0.35 * seconds; paint(); }
  if (clock.glide) glideOn(now);
  clock.runs = state.playing || state.spin || Boolean(clock.glide);
  if (kept.due) draw();
  if (clock.runs) requestAnimationFrame(tick);
}

function run() {
  if (clock.runs) return;
  clock.runs = true;
  clock.last = performance.now();
  requestAnimationFrame(tick);
}

function glideTo(target) {
  if (calm.matches) { Object.assign(state, target); paint(); return; }
  const from = {}, turn = 2 * Math.PI;
  for (const key of Object.keys(target)) from[key] = state[key];
  if ('yaw' in target) from.yaw = target.yaw + ((((state.yaw - target.yaw + Math.PI) % turn) + turn) % turn) - Math.PI;
  clock.glide = { from, target, start: performance.now() };
  run();
}

function glideOn(now) {
  const { from, target, start } = clock.glide, t = Math.max(0, Math.min(1, (now - start) / 350)), eased = t * t * (3 - 2 * t);
  for (const key of Object.keys(target)) state[key] = from[key] + (target[key] - from[key]) * eased;
  if (t >= 1) clock.glide = null;
  paint();
}

function play(on = !state.playing) {
  state.playing = on && clipNow().frames.length > 1;
  clock.spare = 0;
  show();
  run();
}

function stop(moment) { if (state.playing) play(false); go(moment); }

function seeFrom(name) { state.spin = false; glideTo({ ...HOME, yaw: VIEWS[name][0], pitch: VIEWS[name][1] }); show(); }

function turnBy(yaw, pitch) {
  clock.glide = null;
  state.yaw += yaw;
  state.pitch = Math.max(-1.57, Math.min(1.57, state.pitch + pitch));
  paint();
}

function zoomBy(factor) { state.zoom = Math.max(0.2, Math.min(20, state.zoom * factor)); paint(); }
