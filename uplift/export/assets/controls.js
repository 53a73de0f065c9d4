// Controls: the buttons, what is offered of them, and the start.
const NEEDS = { truth: 'truth', uncertainty: 'uncertainty', placed: 'place' };

function show() {
  const pressed = (button, on) => button.setAttribute('aria-pressed', on);
  byId('play').classList.toggle('on', state.playing);
  byId('play').setAttribute('aria-label', state.playing ? 'Pause' : 'Play');
  for (const button of document.querySelectorAll('[data-toggle]')) pressed(button, state[button.dataset.toggle]);
  for (const name of ['level', 'placed']) {
    for (const button of document.querySelectorAll(`[data-${name}]`)) pressed(button, state[name] === (button.dataset[name] === '1'));
  }
  for (const item of document.querySelectorAll('[data-sides]')) item.hidden = state.tint || !meta.jointSides.some(Boolean);
  byId('people').classList.toggle('tinted', state.tint);
  byId('legend-truth').hidden = !state.truth;
  byId('legend-bars').hidden = !state.uncertainty;
  plot.due = true;
  tellPeople();
  paint();
}

function toggle(name) {
  if ((name === 'video' && !meta.behind) || (NEEDS[name] && !kept.arrays[NEEDS[name]]) || (name === 'tint' && clipNow().individuals.length < 2)) return;
  state[name] = !state[name];
  if (name === 'level' || name === 'placed') measureClip();
  show();
  run();
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  kept.colours = palette();
  kept.stripDue = plot.due = true;
  paint();
}

function wireButtons() {
  byId('play').onclick = () => play();
  byId('scrub').oninput = (event) => (kept.stills ? openClip(Number(event.target.value)) : stop(Number(event.target.value)));
  byId('speed').onchange = (event) => { state.speed = Number(event.target.value); };
  byId('theme').onclick = () => theme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
  for (const button of document.querySelectorAll('[data-toggle]')) button.onclick = () => toggle(button.dataset.toggle);
  for (const button of document.querySelectorAll('[data-view]')) button.onclick = () => seeFrom(button.dataset.view);
  for (const name of ['level', 'placed']) {
    for (const button of document.querySelectorAll(`[data-${name}]`)) button.onclick = () => { if (state[name] !== (button.dataset[name] === '1')) toggle(name); };
  }
  addEventListener('resize', fit);
  const watcher = new ResizeObserver(fit);
  for (const id of ['deep', 'flat', 'strip', 'plot']) watcher.observe(byId(id));
}

// Hides what this data has no use for.
function offer(arrays) {
  const { filled, level } = arrays;
  byId('frame-box').hidden = level.codes.every((_, k) => Math.abs(value(level, k) - (k % 9 % 4 ? 0 : 1)) < 1e-3);
  byId('place-box').hidden = !arrays.place;
  document.querySelector('[data-toggle=video]').hidden = !meta.behind;
  if (!meta.rooted) document.querySelector('[data-placed="1"]').textContent = 'As in the image';
  byId('legend-missing').hidden = filled.codes.every((_, k) => value(filled, k) < 0.5);
  byId('legend-uncertainty').hidden = !arrays.uncertainty || byId('legend-missing').hidden;
  for (const name of ['truth', 'uncertainty']) document.querySelector(`[data-toggle=${name}]`).hidden = !arrays[name];
}

async function start() {
  for (const [query, names] of [['(prefers-color-scheme: dark)', ['light', 'dark']], ['(prefers-contrast: more)', null]]) {
    const media = matchMedia(query), follow = () => theme(names ? names[Number(media.matches)] : document.documentElement.dataset.theme);
    follow();
    media.addEventListener('change', follow);
  }
  const arrays = decode(await inflate(meta.packed));
  kept.clips = buildClips(arrays);
  kept.arrays = arrays;
  state.truth = Boolean(arrays.truth);
  offer(arrays);
  wireClips();
  wireButtons();
  wirePointer(byId('deep'));
  wireAngles();
  openClip(0);
  fit();
  play(!calm.matches);
  document.documentElement.dataset.ready = 'yes';
}

window.uplift = {
  state: () => ({ ...state, frames: clipNow().frames.length, clips: kept.clips.length, figures: kept.figures.length, painted: kept.painted, drawMs: kept.drawMs,
    hover: kept.hover && meta.joints[kept.hover.joint], roots: kept.figures.map((figure) => [...figure.shift]), floor: kept.size.floor }),
  draw: (change) => { Object.assign(state, change); draw(); },
};
start().catch((error) => { byId('deep-note').textContent = `This browser could not show the poses (${error.message}); one from 2023 or later can.`; document.documentElement.dataset.ready = 'failed'; });
