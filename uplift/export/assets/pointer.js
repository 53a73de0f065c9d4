// Pointer: dragging turns, two fingers zoom and move, and the joint under it tells what is known of it.
const held = new Map();
const TAP = 6;
let moved = 0, before = null;

function pinch() { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); }

function drag(event) {
  const was = held.get(event.pointerId), dx = event.clientX - was.x, dy = event.clientY - was.y;
  const apart = held.size === 2 ? pinch() : 0;
  moved += Math.hypot(dx, dy);
  Object.assign(was, { x: event.clientX, y: event.clientY });
  if (held.size === 2) { zoomBy(pinch() / Math.max(apart, 1)); state.panX += dx / 2; state.panY += dy / 2; }
  else if (event.shiftKey || event.buttons & 4) { state.panX += dx; state.panY += dy; }
  else turnBy(-dx * 0.008, dy * 0.008);
  paint();
}

function wirePointer(deep) {
  deep.addEventListener('pointerdown', (event) => {
    try { deep.setPointerCapture(event.pointerId); } catch { /* a pointer that is already gone */ }
    if (!held.size) { moved = 0; before = { yaw: state.yaw, pitch: state.pitch, spin: state.spin }; }
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    clock.glide = null; state.spin = false; deep.classList.add('held'); pointAt(null); show();
  });
  deep.addEventListener('pointermove', (event) => (held.has(event.pointerId) ? drag(event) : pointAt(event, 'points', 4)));
  for (const name of ['pointerup', 'pointercancel']) {
    deep.addEventListener(name, (event) => {
      held.delete(event.pointerId);
      deep.classList.toggle('held', held.size > 0);
      if (name === 'pointerup' && moved < TAP) pointAt(event, 'points', 4);
      // The browser took the swipe to scroll the page: nothing was to be turned.
      if (name === 'pointercancel') { Object.assign(state, before); show(); run(); }
    });
  }
  deep.addEventListener('wheel', (event) => { event.preventDefault(); zoomBy(Math.exp(-event.deltaY * (event.deltaMode ? 0.04 : 0.0015))); }, { passive: false });
  deep.addEventListener('dblclick', () => glideTo(HOME));
  for (const name of ['pointermove', 'pointerdown']) byId('flat').addEventListener(name, (event) => pointAt(event, 'flat', 2));
  // A finger that is lifted leaves the tip where it tapped.
  for (const canvas of [deep, byId('flat')]) canvas.addEventListener('pointerleave', (event) => event.pointerType !== 'touch' && pointAt(null));
}

// The joint nearest to the pointer, with its name and coordinates beside it.
function pointAt(event, field, stride) {
  const tip = byId('tip'), best = event ? nearest(event, field, stride) : null;
  if (best || kept.hover) paint();
  kept.hover = best;
  tip.hidden = !best;
  if (!best) return;
  tip.textContent = describe(best.figure, best.joint);
  const card = byId('viewer').getBoundingClientRect(), left = event.clientX - card.left + 16;
  tip.style.left = Math.max(4, Math.min(left, card.width - tip.offsetWidth - 8)) + 'px';
  tip.style.top = event.clientY - card.top + 14 + 'px';
}

function nearest(event, field, stride) {
  const box = event.currentTarget.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
  let best = null, least = event.pointerType === 'touch' ? 26 : 15;
  for (const figure of kept.figures) {
    for (let joint = 0; joint < J; joint++) {
      const gap = Math.hypot(figure[field][stride * joint] - x, figure[field][stride * joint + 1] - y);
      if (gap < least) { least = gap; best = { joint, figure, who: figure.who }; }
    }
  }
  return best;
}

function describe(figure, joint) {
  const K = kept.arrays.keypoints, k = 2 * (figure.row * J + joint), who = figure.name ? ` · ${figure.name}` : '';
  const at = [0, 1, 2].map((a) => tidy(figure.world[3 * joint + a] - figure.shift[a])).join('  ');
  const unit = meta.unit === 'relative' ? '' : ' ' + meta.unit, uncertainty = uncertaintyOf(figure, joint);
  const depth = uncertainty >= 0 ? `\n${filledAt(figure, joint) ? 'place' : 'depth'} ± ${tidy(uncertainty)}${unit}` : '';
  const sure = `confidence ${sureOf(figure, joint).toFixed(2)}`;
  const seen = K.codes[k] === ABSENT ? '' : `2D  ${tidy(value(K, k))}  ${tidy(value(K, k + 1))} px · `;
  const input = filledAt(figure, joint) ? `not seen in 2D, filled in · ${sure}` : seen + sure;
  return `${meta.joints[joint]}${who}\nx y z  ${at}${unit}${depth}\n${input}`;
}
