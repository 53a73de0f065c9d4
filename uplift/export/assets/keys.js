// Keys: everything that the pointer can do, too.
const KEYS = {
  ' ': () => play(), k: () => play(), ArrowRight: (by) => step(by), ArrowLeft: (by) => step(-by), Home: () => step(-Infinity), End: () => step(Infinity),
  PageDown: () => stepClip(1), PageUp: () => stepClip(-1), ',': () => speedUp(-1), '<': () => speedUp(-1), '.': () => speedUp(1), '>': () => speedUp(1),
  '+': () => zoomBy(1.2), '=': () => zoomBy(1.2), '-': () => zoomBy(1 / 1.2), 0: () => glideTo(HOME),
  1: () => seeFrom('front'), 2: () => seeFrom('side'), 3: () => seeFrom('top'),
  a: () => turnBy(0.12, 0), d: () => turnBy(-0.12, 0), w: () => turnBy(0, 0.08), s: () => turnBy(0, -0.08),
  l: () => toggle('level'), p: () => toggle('placed'), c: () => toggle('tint'), t: () => toggle('truth'), u: () => toggle('uncertainty'), n: () => toggle('names'), r: () => toggle('spin'), v: () => toggle('video'),
};

// Photos are stepped over like the frames of a film.
function step(by) {
  if (kept.stills) stepClip(by);
  else stop(state.moment + by);
}

function speedUp(by) {
  const speed = byId('speed');
  speed.selectedIndex = Math.max(0, Math.min(speed.options.length - 1, speed.selectedIndex + by));
  state.speed = Number(speed.value);
}

addEventListener('keydown', (event) => {
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.('select, input[type=search]')) return;
  if (event.key === ' ' && event.target.matches?.('button')) return;
  if (event.key.startsWith('Page') && kept.clips.length < 2) return; // it scrolls
  event.preventDefault();
  action(event.shiftKey ? 10 : 1);
});
