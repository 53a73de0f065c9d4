// Controls: buttons, keys, pointer, the clock, and the start.
function show() {
  byId('play').classList.toggle('on', state.playing);
  byId('play').setAttribute('aria-label', state.playing ? 'Pause' : 'Play');
  for (const button of document.querySelectorAll('[data-toggle]')) button.setAttribute('aria-pressed', state[button.dataset.toggle]);
  for (const button of document.querySelectorAll('[data-level]')) button.setAttribute('aria-pressed', state.level === (button.dataset.level === '1'));
  byId('legend-truth').hidden = !state.truth;
  paint();
}

const clock = { last: 0, spare: 0, runs: false, glide: null };

function tick(now) {
  const seconds = Math.min(0.1, (now - clock.last) / 1000);
  clock.last = now;
  if (state.playing) {
    clock.spare += seconds * (meta.fps || 25) * state.speed;
    const steps = Math.floor(clock.spare);
    clock.spare -= steps;
    if (steps) go((state.moment + steps) % clipNow().frames.length);
  }
  if (state.spin) { state.yaw += 0.35 * seconds; paint(); }
  if (clock.glide) glideOn(now);
  clock.runs = state.playing || state.spin || Boolean(clock.glide);
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

function toggle(name) {
  const offered = { truth: 'truth', spread: 'spread' }[name];
  if (offered && !kept.arrays[offered]) return;
  state[name] = !state[name];
  if (name === 'level') measureClip();
  show();
  run();
}

function seeFrom(name) { state.spin = false; glideTo({ ...HOME, yaw: VIEWS[name][0], pitch: VIEWS[name][1] }); show(); }

const KEYS = {
  ' ': () => play(), k: () => play(), ArrowRight: (by) => stop(state.moment + by), ArrowLeft: (by) => stop(state.moment - by),
  Home: () => stop(0), End: () => stop(Infinity), l: () => toggle('level'), t: () => toggle('truth'), u: () => toggle('spread'),
  n: () => toggle('names'), r: () => toggle('spin'), 0: () => glideTo(HOME), 1: () => seeFrom('front'), 2: () => seeFrom('side'), 3: () => seeFrom('top'),
};

function stop(moment) { if (state.playing) play(false); go(moment); }

addEventListener('keydown', (event) => {
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.('select')) return;
  if (event.key === ' ' && event.target.matches?.('button')) return;
  event.preventDefault();
  action(event.shiftKey ? 10 : 1);
});

const held = new Map();

function pinch() { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); }

function drag(event) {
  const was = held.get(event.pointerId), dx = event.clientX - was.x, dy = event.clientY - was.y;
  const before = held.size === 2 ? pinch() : 0;
  Object.assign(was, { x: event.clientX, y: event.clientY });
  if (held.size === 2) { zoomBy(pinch() / Math.max(before, 1)); state.panX += dx / 2; state.panY += dy / 2; }
  else if (event.shiftKey || event.buttons & 4) { state.panX += dx; state.panY += dy; }
  else { state.yaw -= dx * 0.008; state.pitch = Math.max(-1.57, Math.min(1.57, state.pitch + dy * 0.008)); }
  paint();
}

function zoomBy(factor) { state.zoom = Math.max(0.2, Math.min(20, state.zoom * factor)); paint(); }

function wirePointer(deep) {
  deep.addEventListener('pointerdown', (event) => {
    try { deep.setPointerCapture(event.pointerId); } catch { /* a pointer that is already gone */ }
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    clock.glide = null; state.spin = false; deep.classList.add('held'); point3d(null); show();
  });
  deep.addEventListener('pointermove', (event) => (held.has(event.pointerId) ? drag(event) : point3d(event, 'points', 4)));
  for (const name of ['pointerup', 'pointercancel']) deep.addEventListener(name, (event) => { held.delete(event.pointerId); deep.classList.toggle('held', held.size > 0); });
  deep.addEventListener('wheel', (event) => { event.preventDefault(); zoomBy(Math.exp(-event.deltaY * (event.deltaMode ? 0.04 : 0.0015))); }, { passive: false });
  deep.addEventListener('dblclick', () => glideTo(HOME));
  byId('flat').addEventListener('pointermove', (event) => point3d(event, 'flat', 2));
  for (const canvas of [deep, byId('flat')]) canvas.addEventListener('pointerleave', () => point3d(null));
}

// The joint nearest to the pointer, its name and coordinates beside it.
function point3d(event, field, stride) {
  const tip = byId('tip');
  let best = null;
  if (event) {
    const box = event.target.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    let nearest = 15;
    for (const figure of kept.figures) {
      for (let joint = 0; joint < J; joint++) {
        const gap = Math.hypot(figure[field][stride * joint] - x, figure[field][stride * joint + 1] - y);
        if (gap < nearest) { nearest = gap; best = { name: figure.name, joint, figure }; }
      }
    }
  }
  if (best || kept.hover) paint();
  kept.hover = best;
  tip.hidden = !best;
  if (!best) return;
  tip.textContent = describe(best.figure, best.joint, field);
  const card = byId('viewer').getBoundingClientRect(), left = event.clientX - card.left + 16;
  tip.style.left = Math.max(4, Math.min(left, card.width - tip.offsetWidth - 8)) + 'px';
  tip.style.top = event.clientY - card.top + 14 + 'px';
}

function describe(figure, joint, field) {
  const K = kept.arrays.keypoints, k = 2 * (figure.row * J + joint), who = figure.name ? ` · ${figure.name}` : '';
  const at = [0, 1, 2].map((a) => figure.world[3 * joint + a] - (figure.shift[a] || 0)).map(tidy).join('  ');
  const unit = meta.unit === 'relative' ? '' : ' ' + meta.unit;
  const spread = figure.spread ? `\ndepth ± ${tidy(figure.spread[joint])}${unit}` : '';
  const input = figure.missing[joint] ? 'not seen in 2D, filled in'
    : `2D  ${tidy(value(K, k))}  ${tidy(value(K, k + 1))} px · confidence ${figure.sure[joint].toFixed(2)}`;
  return `${meta.joints[joint]}${who}\n${field === 'flat' ? '3D  ' : 'x y z  '}${at}${unit}${spread}\n${input}`;
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  kept.colours = palette();
  paint();
}

function wireButtons() {
  byId('play').onclick = () => play();
  byId('scrub').oninput = (event) => stop(Number(event.target.value));
  byId('speed').onchange = (event) => { state.speed = Number(event.target.value); };
  byId('clip').onchange = (event) => openClip(Number(event.target.value));
  byId('theme').onclick = () => theme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
  for (const button of document.querySelectorAll('[data-toggle]')) button.onclick = () => toggle(button.dataset.toggle);
  for (const button of document.querySelectorAll('[data-view]')) button.onclick = () => seeFrom(button.dataset.view);
  for (const button of document.querySelectorAll('[data-level]')) button.onclick = () => { if (state.level !== (button.dataset.level === '1')) toggle('level'); };
  new ResizeObserver(paint).observe(byId('viewer'));
}

// Hides what this data has no use for.
function offer(arrays) {
  const { confidence, level } = arrays;
  byId('clip-box').hidden = kept.clips.length < 2;
  byId('transport').hidden = kept.clips.every((clip) => clip.frames.length < 2);
  byId('frame-box').hidden = level.codes.every((_, k) => Math.abs(value(level, k) - (k % 9 % 4 ? 0 : 1)) < 1e-3);
  byId('legend-missing').hidden = confidence.codes.every((_, k) => value(confidence, k) > 0);
  for (const name of ['truth', 'spread']) document.querySelector(`[data-toggle=${name}]`).hidden = !arrays[name];
  for (const item of document.querySelectorAll('[data-sides]')) item.hidden = !meta.jointSides.some(Boolean);
}

async function start() {
  const dark = matchMedia('(prefers-color-scheme: dark)');
  theme(dark.matches ? 'dark' : 'light');
  dark.addEventListener('change', () => theme(dark.matches ? 'dark' : 'light'));
  const arrays = decode(await inflate(meta.packed));
  kept.clips = buildClips(arrays);
  kept.arrays = arrays;
  kept.clips.forEach((clip, n) => byId('clip').add(new Option(clip.name, n)));
  offer(arrays);
  state.truth = Boolean(arrays.truth);
  wireButtons();
  wirePointer(byId('deep'));
  openClip(0);
  play(!calm.matches);
  document.documentElement.dataset.ready = 'yes';
}

window.uplift = {
  state: () => ({ ...state, frames: clipNow().frames.length, clips: kept.clips.length, figures: kept.figures.length, painted: kept.painted, hover: kept.hover && meta.joints[kept.hover.joint] }),
};
start().catch((error) => { byId('deep-note').textContent = `This browser could not show the poses (${error.message}); one from 2023 or later can.`; document.documentElement.dataset.ready = 'failed'; });
