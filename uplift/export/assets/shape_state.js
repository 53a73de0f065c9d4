// State: which item is shown and how it is turned. Everything that changes it calls paint().
const byId = (id) => document.getElementById(id);
const calm = matchMedia('(prefers-reduced-motion: reduce)');
const SEEN = { turn: 0, lift: 0, zoom: 1, panX: 0, panY: 0 };
const state = { item: 0, sheet: meta.sheet, truth: meta.items.some((one) => one.truth), photo: true, doubt: false, spin: false, ...SEEN };
const kept = { arrays: null, colours: null, photos: new Map(), textures: new Map(), order: meta.items.map((_, k) => k), made: [], due: false, flatDue: true, moving: 0, queued: false, painted: 0, drawMs: 0, agree: NaN, turns: [] };

const figure = (v) => (Number.isFinite(v) ? v.toFixed(2) : '–');
const degrees = (a) => { const d = Math.round((a * 180) / Math.PI); return ((((d + 180) % 360) + 360) % 360) - 180; };

function write(id, text) { if (byId(id).textContent !== text) byId(id).textContent = text; }

function paint(flat = false) {
  kept.flatDue ||= flat;
  if (!kept.due && kept.arrays && !state.sheet) { kept.due = true; requestAnimationFrame(() => kept.due && draw()); }
}

function draw() {
  const start = performance.now();
  kept.due = false;
  drawDeep(byId('deep'), state.item, performance.now() < kept.moving);
  if (kept.flatDue) drawFlat();
  tell();
  kept.painted++;
  kept.drawMs = performance.now() - start;
}

function drawFlat() {
  kept.flatDue = false;
  kept.agree = drawInput(byId('flat'), state.item, kept.photos.get(state.item));
  kept.turns = [...document.querySelectorAll('#turns canvas')].map((canvas, k) => drawTurn(canvas, state.item, (2 * Math.PI * k) / TURNS));
  document.querySelectorAll('#turns output').forEach((out, k) => { out.textContent = Number.isFinite(kept.turns[k]) ? kept.turns[k].toFixed(2) : ''; });
}

function tell() {
  const one = meta.items[state.item], view = turned(one.view, state.turn, state.lift);
  write('flat-note', `${state.photo && kept.photos.has(state.item) ? 'photo, ' : ''}overlap (IoU) ${figure(kept.agree)}`);
  write('deep-note', `turned ${degrees(azimuthOf(view))}°, from ${Math.abs(degrees(tiltOf(view)))}° ${tiltOf(view) < -0.004 ? 'below' : 'above'}`);
  const mean = kept.turns.reduce((a, b) => a + b, 0) / kept.turns.length;
  write('turns-note', Number.isFinite(mean) ? `against the true silhouettes, mean overlap (IoU) ${figure(mean)}` : '');
  write('about', [...one.scores.map((v, k) => `${meta.scoreNames[k]} ${figure(v)}`), one.about].filter(Boolean).join(' · '));
}

// While something moves it is drawn coarser; once it rests, finely again.
function moved() {
  kept.moving = performance.now() + 160;
  clearTimeout(kept.rest);
  kept.rest = setTimeout(() => paint(), 180);
  paint();
}

function turnBy(turn, lift) {
  const tilt = tiltOf(meta.items[state.item].view), most = Math.PI / 2;
  state.turn += turn;
  state.lift = Math.max(-most - tilt, Math.min(most - tilt, state.lift + lift));
  moved();
}

function zoomBy(by) { state.zoom = Math.max(0.3, Math.min(8, state.zoom * by)); moved(); }

function seeFrom(name) {
  const { view } = meta.items[state.item], front = -azimuthOf(view), level = -tiltOf(view);
  const to = { seen: [0, 0], front: [front, level], side: [front + Math.PI / 2, level], back: [front + Math.PI, level], top: [front, Math.PI / 2 + level] }[name];
  state.turn = to[0]; state.lift = to[1]; state.spin = false;
  show();
}

function openItem(item) {
  state.item = Math.max(0, Math.min(meta.items.length - 1, item));
  byId('item').value = state.item;
  write('count', `${kept.order.indexOf(state.item) + 1} of ${meta.items.length}`);
  byId('legend-truth').hidden = !(meta.items[state.item].truth && state.truth);
  paint(true);
}

function stepItem(by) {
  const at = kept.order.indexOf(state.item);
  openItem(kept.order[Math.max(0, Math.min(kept.order.length - 1, at + by))]);
}
