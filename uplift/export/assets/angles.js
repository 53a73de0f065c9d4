// Joint angles: one by name over the clip, on both sides, in the band of its expected error; a mark at this moment.
const INSET = { left: 38, right: 10, top: 8, bottom: 8 };
const plot = { chosen: 0, lines: [], low: 0, high: 0, due: true };
const angleAt = (row, k) => { const { angles } = kept.arrays, at = row * angles.width + k; return angles.codes[at] === ABSENT ? NaN : value(angles, at); };
const offAt = (row, k) => { const { angleErrors } = kept.arrays; return angleErrors ? value(angleErrors, row * angleErrors.width + k) : NaN; };

// The lines of the chosen angle in this clip, one for each side and individual: values and errors at every moment.
function openAngles() {
  if (!kept.arrays.angles) return;
  const clip = clipNow();
  plot.lines = meta.angles[plot.chosen].parts.flatMap(({ place, side }) => clip.individuals.map((name, who) => {
    const values = new Float64Array(clip.frames.length).fill(NaN), errors = new Float64Array(clip.frames.length).fill(NaN);
    clip.moments.forEach((rows, m) => {
      for (const row of rows) if (value(kept.arrays.individual, row) === who) { values[m] = angleAt(row, place); errors[m] = offAt(row, place); }
    });
    return { side, who, name, values, errors };
  }));
  const known = plot.lines.flatMap(({ values }) => [...values]).filter((v) => !Number.isNaN(v));
  const low = known.reduce((a, b) => Math.min(a, b), Infinity), high = known.reduce((a, b) => Math.max(a, b), -Infinity);
  const room = Math.max(5, 0.18 * (high - low));
  plot.low = known.length ? low - room : -10; plot.high = known.length ? high + room : 10;
  plot.due = true;
}

// The angle that changes most beside its error is shown first.
function liveliest() {
  const { angles } = kept.arrays, rows = angles.codes.length / angles.width, telling = meta.angles.map(({ parts }) => {
    const found = [];
    let off = 0;
    for (let row = 0; row < rows; row++) for (const { place } of parts) { const v = angleAt(row, place); if (!Number.isNaN(v)) { found.push(v); off += offAt(row, place) || 0; } }
    if (found.length < 0.9 * rows * parts.length) return 0;
    found.sort((a, b) => a - b);
    const range = found[Math.floor(0.95 * (found.length - 1))] - found[Math.floor(0.05 * (found.length - 1))];
    return range > 300 ? 0 : range / (off / found.length + 5); // more than that goes once round: where it heads, not how it bends
  });
  return telling.indexOf(Math.max(...telling));
}

const plotX = (m, width) => INSET.left + (m / Math.max(1, clipNow().frames.length - 1)) * (width - INSET.left - INSET.right);
const plotY = (v, height) => INSET.top + ((plot.high - v) / (plot.high - plot.low)) * (height - INSET.top - INSET.bottom);
const plotRamp = ({ side, who }) => kept.colours.hues[state.tint ? SIDES.length + (who % PEOPLE) : side][0];
const degrees = (v) => `${v.toFixed(0).replace(/^-(?!0$)/, '−').replace('-', '')}°`;
const shownLines = () => plot.lines.filter(({ name }) => !kept.hidden.has(name));

function drawGrid(ctx, width, height) {
  const rough = (plot.high - plot.low) / 4, step = [5, 10, 15, 30, 45, 60, 90].find((one) => one >= rough) || 90;
  ctx.font = 11 + FONT; ctx.textAlign = 'right'; ctx.textBaseline = 'middle'; ctx.lineWidth = 1;
  for (let v = Math.ceil(plot.low / step) * step; v <= plot.high; v += step) {
    ctx.strokeStyle = v === 0 ? kept.colours.soft : kept.colours.faint; ctx.fillStyle = kept.colours.soft;
    line(ctx, INSET.left, plotY(v, height), width - INSET.right, plotY(v, height));
    ctx.fillText(degrees(v), INSET.left - 7, plotY(v, height));
  }
}

// Runs of moments with values, parted where one is not known and where it goes over from 180 to -180.
function runsOf(values) {
  const runs = [];
  values.forEach((v, m) => {
    if (Number.isNaN(v)) return;
    const last = runs[runs.length - 1];
    if (last && last[last.length - 1] === m - 1 && Math.abs(v - values[m - 1]) < 180) last.push(m); else runs.push([m]);
  });
  return runs;
}

function drawLine(ctx, width, height, one) {
  ctx.strokeStyle = ctx.fillStyle = plotRamp(one);
  ctx.lineWidth = 1.8; ctx.lineJoin = 'round';
  ctx.setLineDash(state.tint && one.side === 1 ? [5, 4] : []); // colours are of individuals then
  for (const run of runsOf(one.values)) {
    const edge = (m, sign) => [plotX(m, width), plotY(one.values[m] + sign * (one.errors[m] || 0), height)];
    ctx.globalAlpha = 0.16;
    ctx.beginPath();
    for (const m of run) ctx.lineTo(...edge(m, 1));
    for (const m of [...run].reverse()) ctx.lineTo(...edge(m, -1));
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.beginPath();
    for (const m of run) ctx.lineTo(...edge(m, 0));
    if (run.length === 1) ctx.arc(...edge(run[0], 0), 1.5, 0, 7);
    ctx.stroke();
  }
  ctx.setLineDash([]);
}

function drawAngles(ctx, width, height) {
  ctx.clearRect(0, 0, width, height);
  drawGrid(ctx, width, height);
  ctx.save();
  ctx.beginPath(); ctx.rect(INSET.left, 0, width - INSET.left - INSET.right, height); ctx.clip();
  for (const one of shownLines()) drawLine(ctx, width, height, one);
  ctx.restore();
}

const SIDE_NAMES = ['', 'left ', 'right '];

function tellAngles() {
  const shown = shownLines(), several = new Set(shown.map(({ name }) => name)).size > 1;
  const texts = shown.filter(({ values }) => !Number.isNaN(values[state.moment])).slice(0, 6).map(({ side, name, values, errors }) => {
    const off = errors[state.moment];
    return `${several ? name + ' ' : ''}${SIDE_NAMES[side]}${degrees(values[state.moment])}${off >= 0 ? ` ± ${Math.max(1, off).toFixed(0)}` : ''}`;
  });
  write('angle-note', texts.join(' · ') || 'cannot be measured here');
}

function showAngles([ctx, width, height]) {
  if (!kept.arrays.angles) return;
  if (plot.due) { drawAngles(ctx, width, height); plot.due = false; }
  byId('plot-mark').style.transform = `translateX(${plotX(state.moment, width).toFixed(1)}px)`;
  tellAngles();
}

function wireAngles() {
  byId('angles').hidden = !kept.arrays.angles;
  if (!kept.arrays.angles) return;
  plot.chosen = Math.max(0, liveliest());
  byId('angle').replaceChildren(...meta.angles.map(({ name }, n) => new Option(name, n)));
  byId('angle').value = plot.chosen;
  byId('angle').onchange = (event) => { plot.chosen = Number(event.target.value); openAngles(); paint(); };
  const seek = (event) => {
    const box = byId('plot').getBoundingClientRect(), share = (event.clientX - box.left - INSET.left) / (box.width - INSET.left - INSET.right);
    stop(Math.round(share * (clipNow().frames.length - 1)));
  };
  byId('plot').addEventListener('pointerdown', (event) => { byId('plot').setPointerCapture(event.pointerId); seek(event); });
  byId('plot').addEventListener('pointermove', (event) => { if (event.buttons) seek(event); });
}
