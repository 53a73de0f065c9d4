// State: what is shown, and one drawing of it. Everything that changes the state calls paint().
const byId = (id) => document.getElementById(id);
const calm = matchMedia('(prefers-reduced-motion: reduce)');
const HOME = { yaw: -0.5, pitch: 0.16, zoom: 1, panX: 0, panY: 0 };
const VIEWS = { front: [0, 0], side: [Math.PI / 2, 0], top: [0, Math.PI / 2 - 0.001] };
const state = { clip: 0, moment: 0, playing: false, speed: 1, level: true, truth: false, spread: false, names: false, spin: false, ...HOME };
const kept = { arrays: null, clips: [], size: null, bounds: null, errors: null, figures: [], colours: null, due: false, hover: null, painted: 0 };

const clipNow = () => kept.clips[state.clip];
// A tenth of a mm or px is all that lengths can carry; numbers without a unit keep three figures.
const tidy = (v) => (meta.unit !== 'relative' ? Number(v.toFixed(Math.abs(v) < 100 ? 1 : 0)).toString() : Math.abs(v) >= 100 || v === 0 ? v.toFixed(0) : Math.abs(v) >= 10 ? v.toFixed(1) : v.toFixed(3));

function figureOf(row) {
  const A = kept.arrays, world = new Float64Array(3 * J), shift = placeRow(A, row, 'pose', state.level, world);
  const figure = { row, world, shift, name: clipNow().individuals[value(A.individual, row)], missing: [], sure: [] };
  for (let j = 0; j < J; j++) {
    figure.sure.push(value(A.confidence, row * J + j));
    figure.missing.push(figure.sure[j] <= 0);
  }
  if (A.truth && state.truth) placeRow(A, row, 'truth', state.level, (figure.truthWorld = new Float64Array(3 * J)), shift);
  if (A.spread) figure.spread = Array.from({ length: J }, (_, j) => value(A.spread, row * J + j));
  figure.away = state.level ? [2, 5, 8].map((k) => value(A.level, 9 * row + k)) : [0, 0, 1];
  return figure;
}

function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const wide = Math.round(box.width * ratio), tall = Math.round(box.height * ratio);
  if (canvas.width !== wide || canvas.height !== tall) { canvas.width = wide; canvas.height = tall; }
  const ctx = canvas.getContext('2d');
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [ctx, box.width, box.height];
}

function draw() {
  kept.due = false;
  const [deep, wide, tall] = fitted(byId('deep')), [flat, flatWide, flatTall] = fitted(byId('flat'));
  const look = eye(kept.size, state, wide, tall), see = flatEye(kept.bounds, flatWide, flatTall);
  kept.figures = clipNow().moments[state.moment].map(figureOf);
  for (const figure of kept.figures) {
    figure.points = projectRow(look, figure.world);
    figure.truth = figure.truthWorld && projectRow(look, figure.truthWorld);
    figure.flat = flatRow(kept.arrays, figure.row, see);
  }
  draw3d(deep, wide, tall, state, kept.figures, kept.size, look, kept.colours);
  draw2d(flat, flatWide, flatTall, kept.figures, see, kept.colours);
  if (kept.errors) drawStrip(...fitted(byId('strip')), kept.errors, state.moment, kept.colours);
  if (kept.hover) drawHover(deep, flat);
  kept.painted++;
  tell();
}

function drawHover(deep, flat) {
  const figure = kept.figures.find((one) => one.name === kept.hover.name);
  if (!figure) return;
  const j = kept.hover.joint;
  for (const [ctx, x, y] of [[deep, figure.points[4 * j], figure.points[4 * j + 1]], [flat, figure.flat[2 * j], figure.flat[2 * j + 1]]]) {
    if (Number.isNaN(x)) continue;
    ctx.strokeStyle = kept.colours.ink; ctx.lineWidth = 2;
    ctx.beginPath(); ctx.arc(x, y, 9, 0, 7); ctx.stroke();
  }
}

function paint() {
  if (!kept.due && kept.arrays) { kept.due = true; requestAnimationFrame(draw); }
}

function tell() {
  const clip = clipNow(), rate = meta.fps || 25, last = clip.frames.length - 1;
  byId('scrub').value = state.moment;
  byId('clock').textContent = `frame ${clip.frames[state.moment]} · ${(state.moment / rate).toFixed(1)} of ${(last / rate).toFixed(1)} s`;
  byId('scrub').setAttribute('aria-valuetext', `frame ${clip.frames[state.moment]}`);
  const missing = kept.figures.reduce((sum, one) => sum + one.missing.filter(Boolean).length, 0);
  const size = meta.imageSize ? `${meta.imageSize[0]} × ${meta.imageSize[1]} px` : 'pixels';
  byId('flat-note').textContent = size + (missing ? ` · ${missing} of ${J * kept.figures.length} joints not seen` : '');
  const scale = meta.unit === 'mm' ? ` · squares ${tidy(gridStep(kept.size.radius))} mm` : '';
  byId('deep-note').textContent = (state.level ? 'level frame' : 'camera frame') + (state.level && meta.gravity ? scale : '');
  if (kept.errors) {
    const error = kept.errors[state.moment];
    byId('strip-note').textContent = error >= 0 ? `error at the best scale (n_mpjpe): ${tidy(error)}${meta.truthUnit === 'relative' ? '' : ' ' + meta.truthUnit}` : '';
  }
}

function go(moment) {
  const last = clipNow().frames.length - 1;
  state.moment = Math.max(0, Math.min(last, moment));
  paint();
}

function measureClip() {
  kept.size = measure(kept.arrays, clipNow(), state.level);
  kept.bounds = measureFlat(kept.arrays, clipNow());
}

function openClip(index) {
  state.clip = index;
  const E = kept.arrays.error;
  kept.errors = E && clipNow().moments.map((rows) => {
    const known = rows.filter((row) => E.codes[row] !== ABSENT);
    return known.length ? known.reduce((sum, row) => sum + value(E, row), 0) / known.length : NaN;
  });
  measureClip();
  byId('scrub').max = clipNow().frames.length - 1;
  byId('scrub').disabled = byId('play').disabled = clipNow().frames.length < 2;
  byId('clip').value = index;
  go(0);
}
