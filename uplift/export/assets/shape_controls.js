// Controls: buttons, keys, the pointer, and the start.
const held = new Map();

function setSheet(on) {
  state.sheet = on;
  byId('single').hidden = on; byId('sheet').hidden = !on;
  show();
  if (on) queueTiles();
  else if (kept.made[state.item]) kept.made[state.item].tile.blur();
}

function show() {
  for (const button of document.querySelectorAll('[data-toggle]')) button.setAttribute('aria-pressed', state[button.dataset.toggle]);
  for (const button of document.querySelectorAll('[data-sheet]')) button.setAttribute('aria-pressed', state.sheet === (button.dataset.sheet === '1'));
  for (const part of document.querySelectorAll('[data-one]')) part.hidden = state.sheet;
  byId('sort').hidden = !state.sheet || !meta.scoreNames.length;
  paint(true);
}

function toggle(name) {
  const button = document.querySelector(`[data-toggle=${name}]`);
  if (button.hidden) return;
  state[name] = !state[name];
  byId('legend-truth').hidden = !(meta.items[state.item].truth && state.truth);
  byId('legend-doubt').hidden = !state.doubt;
  show(); staleTiles();
  if (name === 'spin') spin();
}

function spin(before = performance.now()) {
  if (!state.spin) { paint(); return; }
  requestAnimationFrame((now) => { turnBy(-0.0006 * Math.min(50, now - before), 0); spin(now); });
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  kept.colours = palette();
  staleTiles(); paint(true);
}

// Tiles in the order of a score, or as they were given.
function sortBy(name) {
  const column = meta.scoreNames.indexOf(name), score = (k) => { const v = meta.items[k].scores[column]; return Number.isFinite(v) ? v : -Infinity; };
  kept.order = meta.items.map((_, k) => k);
  if (column >= 0) kept.order.sort((a, b) => score(a) - score(b));
  fillSheet(); openItem(state.item);
}

function wirePointer(deep) {
  let start = null;
  const spread = () => { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  deep.addEventListener('pointerdown', (event) => {
    try { deep.setPointerCapture(event.pointerId); } catch { /* a pointer that is already gone */ }
    if (!held.size) start = { turn: state.turn, lift: state.lift };
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    state.spin = false; deep.classList.add('held'); show();
  });
  deep.addEventListener('pointermove', (event) => {
    const was = held.get(event.pointerId);
    if (!was) return;
    const dx = event.clientX - was.x, dy = event.clientY - was.y, before = held.size === 2 ? spread() : 0;
    Object.assign(was, { x: event.clientX, y: event.clientY });
    if (held.size === 2) { state.panX += dx / 2; state.panY += dy / 2; zoomBy(spread() / Math.max(before, 1)); }
    else if (event.shiftKey || event.buttons & 4) { state.panX += dx; state.panY += dy; moved(); }
    else turnBy(-dx * 0.009, dy * 0.009);
  });
  for (const name of ['pointerup', 'pointercancel']) {
    deep.addEventListener(name, (event) => {
      held.delete(event.pointerId); deep.classList.toggle('held', held.size > 0);
      if (name === 'pointercancel') { Object.assign(state, start); moved(); } // the browser scrolls the page instead
    });
  }
  deep.addEventListener('wheel', (event) => { event.preventDefault(); zoomBy(Math.exp(-event.deltaY * (event.deltaMode ? 0.04 : 0.0015))); }, { passive: false });
  deep.addEventListener('dblclick', () => { Object.assign(state, SEEN); show(); });
}

const KEYS = {
  ArrowRight: () => stepItem(1), ArrowLeft: () => stepItem(-1), PageDown: () => stepItem(1), PageUp: () => stepItem(-1), Home: () => openItem(kept.order[0]), End: () => openItem(kept.order.at(-1)),
  a: () => turnBy(0.12, 0), d: () => turnBy(-0.12, 0), w: () => turnBy(0, -0.08), s: () => turnBy(0, 0.08), '+': () => zoomBy(1.2), '=': () => zoomBy(1.2), '-': () => zoomBy(1 / 1.2),
  0: () => { Object.assign(state, SEEN, { spin: false }); show(); }, 1: () => seeFrom('seen'), 2: () => seeFrom('front'), 3: () => seeFrom('side'), 4: () => seeFrom('back'), 5: () => seeFrom('top'),
  t: () => toggle('truth'), p: () => toggle('photo'), u: () => toggle('doubt'), r: () => toggle('spin'), Escape: () => setSheet(true),
};
const TILE_KEYS = { ArrowRight: () => stepTile(1), ArrowLeft: () => stepTile(-1), ArrowDown: () => stepTile(columnsOf()), ArrowUp: () => stepTile(-columnsOf()) };

addEventListener('keydown', (event) => {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.('select, input')) return;
  const onTile = event.target.matches?.('.tile');
  const action = key === 'g' ? () => setSheet(!state.sheet) : state.sheet ? (onTile ? TILE_KEYS[key] : null) ?? { t: KEYS.t, p: KEYS.p, u: KEYS.u }[key] : KEYS[key];
  if (!action) return;
  event.preventDefault();
  action();
});

function fillTurns() {
  for (let k = 0; k < TURNS; k++) {
    const button = document.createElement('button'), canvas = document.createElement('canvas'), label = document.createElement('span'), out = document.createElement('output');
    button.type = 'button'; button.title = 'Turn the shape to this view';
    button.setAttribute('aria-label', k ? `Turned by ${(360 / TURNS) * k} degrees` : 'As seen');
    label.textContent = k ? `${(360 / TURNS) * k}°` : 'seen';
    button.append(canvas, label, out);
    button.onclick = () => { state.turn = (2 * Math.PI * k) / TURNS; state.lift = 0; state.spin = false; show(); };
    byId('turns').append(button);
  }
}

function wireButtons() {
  meta.items.forEach((one, k) => byId('item').add(new Option(one.name, k)));
  byId('item').onchange = (event) => openItem(Number(event.target.value));
  byId('before').onclick = () => stepItem(-1);
  byId('after').onclick = () => stepItem(1);
  byId('theme').onclick = () => theme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
  for (const name of meta.scoreNames) byId('by').add(new Option(`${name}, least first`, name));
  byId('by').onchange = (event) => sortBy(event.target.value);
  for (const button of document.querySelectorAll('[data-toggle]')) button.onclick = () => toggle(button.dataset.toggle);
  for (const button of document.querySelectorAll('[data-view]')) button.onclick = () => seeFrom(button.dataset.view);
  for (const button of document.querySelectorAll('[data-sheet]')) button.onclick = () => setSheet(button.dataset.sheet === '1');
  document.querySelector('[data-toggle=truth]').hidden = !state.truth;
  document.querySelector('[data-toggle=photo]').hidden = !kept.photos.size;
  document.querySelector('[data-toggle=doubt]').hidden = !kept.arrays.doubt;
  byId('sheet-box').hidden = byId('pick').hidden = meta.items.length < 2;
  new ResizeObserver(() => paint(true)).observe(byId('deep'));
  let wide = 0; // its height follows from what is drawn
  new ResizeObserver(([box]) => { if (box.contentRect.width !== wide) { wide = box.contentRect.width; staleTiles(); } }).observe(byId('sheet'));
}

async function pictureOf(address) {
  const picture = new Image();
  picture.src = address;
  await picture.decode();
  return picture;
}

function pixelsOf(picture) {
  const canvas = document.createElement('canvas'), { width, height } = picture;
  canvas.width = width; canvas.height = height;
  const ctx = canvas.getContext('2d');
  ctx.drawImage(picture, 0, 0);
  return { width, height, colours: new Uint32Array(ctx.getImageData(0, 0, width, height).data.buffer) };
}

async function loadPhotos() {
  await Promise.all(meta.items.map(async (one, k) => {
    if (one.photo) kept.photos.set(k, await pictureOf(one.photo));
    if (one.texture) kept.textures.set(k, pixelsOf(await pictureOf(one.texture)));
  }));
}

async function start() {
  const media = matchMedia('(prefers-color-scheme: dark)'), follow = () => theme(media.matches ? 'dark' : 'light');
  kept.arrays = decode(await inflate(meta.packed));
  listMeshes();
  await loadPhotos();
  follow();
  media.addEventListener('change', follow);
  fillTurns(); wireButtons(); wirePointer(byId('deep')); fillSheet();
  openItem(0);
  setSheet(state.sheet);
  document.documentElement.dataset.ready = 'yes';
}

window.uplift = { state: () => ({ ...state, items: meta.items.length, painted: kept.painted, drawMs: kept.drawMs, agree: kept.agree, turns: kept.turns, tiles: tiles.filter((one) => one.drawn).length }) };
start().catch((error) => { write('failed', `This browser could not show the shapes (${error.message}); one from 2023 or later can.`); byId('failed').hidden = false; document.documentElement.dataset.ready = 'failed'; });
