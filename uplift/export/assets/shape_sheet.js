// The sheet: every item as a tile that opens it, drawn when it comes into sight.
const tiles = [];

function makeTile(item) {
  const one = meta.items[item], tile = document.createElement('button'), row = document.createElement('span'), name = document.createElement('span'), facts = document.createElement('span');
  tile.type = 'button'; tile.className = 'tile'; tile.dataset.item = item;
  row.className = 'pair'; name.className = 'tile-name'; facts.className = 'tile-facts';
  const canvases = Array.from({ length: one.truth ? 3 : 2 }, () => row.appendChild(document.createElement('canvas')));
  for (const canvas of canvases) canvas.setAttribute('aria-hidden', 'true');
  name.textContent = one.name; name.title = one.id;
  tile.append(row, name, facts);
  tile.onclick = () => { openItem(item); setSheet(false); byId('deep').focus({ preventScroll: true }); };
  return { tile, canvases, facts, item, drawn: false, seen: false };
}

function drawTile(entry) {
  const one = meta.items[entry.item], [flat, deep, truth] = entry.canvases;
  const agree = drawInput(flat, entry.item, kept.photos.get(entry.item));
  const views = [[deep, one, kept.colours.clay], [truth, one.truth, kept.colours.true]].filter(([canvas]) => canvas).map(([canvas, placing, colours]) => ({ canvas, placing, colours, mesh: meshOf(placing.mesh), lift: SHEET_TILT - tiltOf(placing.view) }));
  const most = Math.max(1e-6, ...views.filter(({ mesh }) => mesh).map(({ mesh, placing, lift }) => extentOf(mesh, placing, SHEET_TURN, lift)));
  for (const { canvas, placing, colours, mesh, lift } of views) {
    const { ctx, width, height, ratio } = fitCanvas(canvas);
    if (mesh) drawShape(ctx, mesh, placing, { x: 0, y: 0, width, height, px: (0.43 * width) / most, turn: SHEET_TURN, lift, fine: Math.max(ratio, 2), colours, look: canvas === deep ? lookOf(entry.item, mesh) : null, floor: false });
    else tellNothing(ctx, '', width, height);
  }
  const parts = one.scores.map((v, k) => `${meta.scoreNames[k]} ${figure(v)}`);
  entry.facts.textContent = [...(parts.length ? parts : [`overlap (IoU) ${figure(agree)}`]), one.about].filter(Boolean).join(' · ');
  entry.drawn = true;
}

// Turned a little from how it was seen, so that depth shows.
const SHEET_TURN = -0.6, SHEET_TILT = 0.35;

const watcher = new IntersectionObserver((seen) => {
  for (const { target, isIntersecting } of seen) tiles[Number(target.dataset.place)].seen = isIntersecting;
  queueTiles();
}, { rootMargin: '200px' });

// A few at a time: the page answers while they are drawn.
function queueTiles() {
  if (kept.queued || !state.sheet) return;
  kept.queued = true;
  requestAnimationFrame(() => {
    kept.queued = false;
    const end = performance.now() + 24;
    for (const entry of tiles) {
      if (performance.now() > end) { queueTiles(); return; }
      if (entry.seen && !entry.drawn) drawTile(entry);
    }
  });
}

function staleTiles() { for (const entry of tiles) entry.drawn = false; queueTiles(); }

function fillSheet() {
  const box = byId('sheet');
  box.style.setProperty('--tile', meta.items.some((one) => one.truth) ? '290px' : '220px');
  for (const [place, item] of kept.order.entries()) {
    const entry = kept.made[item] ??= makeTile(item);
    entry.tile.dataset.place = place; tiles[place] = entry;
    box.append(entry.tile); watcher.observe(entry.tile);
  }
}

// Arrow keys go from tile to tile.
function stepTile(by) {
  const at = tiles.findIndex((entry) => entry.tile === document.activeElement);
  const next = tiles[Math.max(0, Math.min(tiles.length - 1, at + by))];
  next.tile.focus();
  return true;
}

function columnsOf() { return Math.max(1, tiles.filter((entry) => entry.tile.offsetTop === tiles[0].tile.offsetTop).length); }
