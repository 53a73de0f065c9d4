// State: what is shown, and one drawing of it. Everything that changes the state calls paint().
const byId = (id) => document.getElementById(id);
const calm = matchMedia('(prefers-reduced-motion: reduce)');
const HOME = { yaw: -0.5, pitch: 0.16, zoom: 1, panX: 0, panY: 0 };
const VIEWS = { front: [0, 0], side: [Math.PI / 2, 0], top: [0, Math.PI / 2 - 0.001] };
const state = { clip: 0, moment: 0, playing: false, speed: 1, level: true, placed: true, tint: false, truth: false, uncertainty: false, names: false, spin: false, video: true, ...HOME };
const kept = { arrays: null, clips: [], listed: [], stills: false, hidden: new Set(), slots: null, size: null, bounds: null, trails: null, strip: null,
  figures: [], colours: null, boxes: null, hover: null, due: false, stripDue: true, painted: 0, drawMs: 0,
  boneWidths: new Float64Array(B), jointRadii: new Float64Array(J), flatWidths: new Float64Array(B), flatRadii: new Float64Array(J),
  boned: Uint8Array.from(meta.joints, (_, j) => meta.bones.some((bone) => bone.includes(j))) };

const clipNow = () => kept.clips[state.clip];
// A tenth of a mm or px is all that lengths can carry; numbers without a unit keep three figures.
const tidy = (v) => (meta.unit !== 'relative' ? Number(v.toFixed(Math.abs(v) < 100 ? 1 : 0)).toString() : Math.abs(v) >= 100 || v === 0 ? v.toFixed(0) : Math.abs(v) >= 10 ? v.toFixed(1) : v.toFixed(3));

// Sizes of the canvases are read when they change, not at every drawing.
function fit() {
  const ratio = window.devicePixelRatio || 1;
  kept.boxes = ['deep', 'flat', 'strip', 'plot'].map((id) => {
    const canvas = byId(id), box = canvas.getBoundingClientRect();
    canvas.width = Math.round(box.width * ratio); canvas.height = Math.round(box.height * ratio);
    const ctx = canvas.getContext('2d');
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    return { ctx, width: box.width, height: box.height };
  });
  kept.stripDue = plot.due = true;
  if (kept.size) draw();
}

function draw() {
  const start = performance.now(), [deep, flat, strip, angles] = kept.boxes;
  kept.due = false;
  const look = eye(kept.size, state, deep.width, deep.height), see = flatEye(kept.bounds, flat.width, flat.height);
  fillFigures(look, see);
  draw3d(deep.ctx, deep.width, deep.height, look);
  draw2d(flat.ctx, flat.width, flat.height, see);
  if (kept.stripDue) { drawStrip(strip.ctx, strip.width, strip.height, kept.strip, kept.colours); kept.stripDue = false; }
  moveMark(kept.strip, strip.width);
  showAngles([angles.ctx, angles.width, angles.height]);
  if (kept.hover) drawHover(deep.ctx, flat.ctx);
  tell();
  kept.painted++;
  kept.drawMs = performance.now() - start;
}

function paint() {
  if (!kept.due && kept.arrays) { kept.due = true; requestAnimationFrame(() => kept.due && draw()); }
}

function write(id, text) {
  const element = byId(id);
  if (element.textContent !== text) element.textContent = text;
}

function tell() {
  const clip = clipNow(), rate = meta.fps || 25, last = clip.frames.length - 1;
  byId('scrub').value = kept.stills ? state.clip : state.moment;
  write('clock', kept.stills ? `${meta.noun} ${state.clip + 1} of ${kept.clips.length}`
    : `frame ${clip.frames[state.moment]} · ${(state.moment / rate).toFixed(1)} of ${(last / rate).toFixed(1)} s`);
  byId('scrub').setAttribute('aria-valuetext', kept.stills ? clip.name : `frame ${clip.frames[state.moment]}`);
  let unseen = 0;
  for (const figure of kept.figures) for (let j = 0; j < J; j++) if (filledAt(figure, j)) unseen++;
  const size = meta.imageSize ? `${meta.imageSize[0]} × ${meta.imageSize[1]} px` : 'pixels';
  write('flat-note', size + (unseen ? ` · ${unseen} of ${J * kept.figures.length} joints not seen` : ''));
  const scale = meta.unit === 'mm' && floored() ? ` · squares of ${squareText()}` : '';
  write('deep-note', (state.level ? 'tilt of the camera undone' : 'as the camera is held') + scale);
  const now = kept.strip ? kept.strip.values[state.moment] : NaN;
  write('strip-note', now >= 0 ? kept.strip.tell(now) : '');
}

function squareText() {
  const step = gridStep(kept.size.radius);
  return step >= 1000 ? `${step / 1000} m` : step >= 10 ? `${step / 10} cm` : `${tidy(step)} mm`;
}

function go(moment) {
  state.moment = Math.max(0, Math.min(clipNow().frames.length - 1, moment));
  paint();
}

function measureClip() {
  kept.slots = lineUp(kept.arrays, clipNow());
  kept.size = measure(kept.arrays, clipNow());
  const { floor } = kept.arrays, [[row]] = clipNow().moments;
  if (floor && floor.codes[row] !== ABSENT) kept.size.floor = value(floor, row);
  if (!floored() || !(meta.rooted && state.placed)) kept.size.floor = 0;
  kept.bounds = measureFlat(kept.arrays, clipNow());
}

function openClip(index) {
  state.clip = index;
  kept.strip = stripOf(kept.arrays, clipNow());
  kept.trails = meta.rooted && clipNow().frames.length > 1 ? trailsOf(kept.arrays, clipNow()) : null;
  kept.stripDue = true;
  byId('transport').classList.toggle('bare', !kept.strip);
  measureClip();
  openAngles();
  byId('plot').parentElement.hidden = clipNow().frames.length < 2;
  byId('scrub').max = (kept.stills ? kept.clips.length : clipNow().frames.length) - 1;
  byId('scrub').disabled = byId('play').disabled = byId('scrub').max < 1;
  byId('clip').value = index;
  showPeople();
  go(0);
}
