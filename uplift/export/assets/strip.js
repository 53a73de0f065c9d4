// The strip over the scrub bar: one number per moment, drawn once per clip; a mark moves over it.
// What starts at zero is an area; what does not is a line from its least to its largest.
const length = (v, unit) => tidy(v) + (unit === 'relative' ? '' : ' ' + unit);
const STRIPS = [
  { array: 'error', fromZero: true, tell: (v) => `error at the best scale (n_mpjpe): ${length(v, meta.truthUnit)}` },
  { array: 'confidence', tell: (v) => `mean 2D confidence ${v.toFixed(2)}` },
  { array: 'uncertainty', tell: (v) => `mean uncertainty ± ${length(v, meta.unit)}` },
];

// The mean over individuals and joints of an array at each moment, NaN where nothing is known.
function meanOf(array, moments) {
  return moments.map((rows) => {
    let sum = 0, count = 0;
    for (const row of rows) {
      for (let k = row * array.width; k < (row + 1) * array.width; k++) if (array.codes[k] !== ABSENT) { sum += value(array, k); count++; }
    }
    return count ? sum / count : NaN;
  });
}

// The first that is known and changes during the clip; null where none does.
function stripOf(A, clip) {
  if (clip.moments.length < 2) return null;
  for (const strip of STRIPS.filter((one) => A[one.array])) {
    const values = meanOf(A[strip.array], clip.moments), known = values.filter((v) => v >= 0);
    const low = known.reduce((a, b) => Math.min(a, b), Infinity), high = known.reduce((a, b) => Math.max(a, b), 0);
    if (high - low > 0.01 * high) return { ...strip, values, high, low: strip.fromZero ? 0 : low };
  }
  return null;
}

function drawStrip(ctx, width, height, strip, colours) {
  ctx.clearRect(0, 0, width, height);
  if (!strip) return;
  const { values, low, high, fromZero } = strip, inset = 8, span = width - 2 * inset;
  ctx.fillStyle = ctx.strokeStyle = fromZero ? colours.faint : colours.soft;
  ctx.lineWidth = 1; ctx.lineJoin = 'round';
  ctx.beginPath();
  if (fromZero) ctx.moveTo(inset, height);
  values.forEach((v, k) => ctx.lineTo(inset + (k / (values.length - 1)) * span, height - 2 - (v >= low ? (v - low) / (high - low) : 0) * (height - 4)));
  if (!fromZero) { ctx.stroke(); return; }
  ctx.lineTo(width - inset, height); ctx.fill();
}

function moveMark(strip, width) {
  const inset = 8, at = inset + (state.moment / Math.max(1, clipNow().frames.length - 1)) * (width - 2 * inset);
  byId('mark').hidden = !strip;
  byId('mark').style.transform = `translateX(${at.toFixed(1)}px)`;
}
