// The 2D view: the keypoints as they came in, and the strip of errors over the scrub bar.
function flatEye(bounds, width, height) {
  const scale = Math.min(width / bounds.wide, height / bounds.tall);
  return (x, y) => [width / 2 + (x - bounds.x) * scale, height / 2 + (y - bounds.y) * scale];
}

// Returns joints x (screen x, y), NaN where nothing was seen.
function flatRow(A, row, see) {
  const out = new Float64Array(2 * J).fill(NaN), K = A.keypoints;
  for (let j = 0; j < J; j++) {
    const k = 2 * (row * J + j);
    if (K.codes[k] !== ABSENT) out.set(see(value(K, k), value(K, k + 1)), 2 * j);
  }
  return out;
}

function drawImageFrame(ctx, see, colours) {
  if (!meta.imageSize) return;
  const [x0, y0] = see(0, 0), [x1, y1] = see(...meta.imageSize);
  ctx.strokeStyle = colours.faint;
  ctx.lineWidth = 1;
  ctx.strokeRect(x0, y0, x1 - x0, y1 - y0);
}

function draw2d(ctx, width, height, figures, see, colours) {
  ctx.clearRect(0, 0, width, height);
  ctx.lineCap = 'round';
  drawImageFrame(ctx, see, colours);
  const thick = Math.max(1.2, Math.min(3.5, 3.5 * Math.sqrt(20 / Math.max(J, 20))));
  for (const { flat, sure, name } of figures) {
    ctx.lineWidth = thick;
    meta.bones.forEach(([a, b], n) => {
      if (Number.isNaN(flat[2 * a] + flat[2 * b])) return;
      ctx.strokeStyle = colours.sides[meta.boneSides[n]][0];
      ctx.globalAlpha = 0.25 + 0.6 * Math.min(sure[a], sure[b], 1);
      line(ctx, flat[2 * a], flat[2 * a + 1], flat[2 * b], flat[2 * b + 1]);
    });
    let top = -1;
    for (let j = 0; j < J; j++) {
      if (Number.isNaN(flat[2 * j])) continue;
      if (top < 0 || flat[2 * j + 1] < flat[2 * top + 1]) top = j;
      ctx.globalAlpha = 0.35 + 0.65 * Math.min(sure[j], 1);
      ctx.fillStyle = colours.sides[meta.jointSides[j]][0];
      ctx.beginPath(); ctx.arc(flat[2 * j], flat[2 * j + 1], thick * 1.05, 0, 7); ctx.fill();
    }
    ctx.globalAlpha = 1;
    if (name && top >= 0) drawLabel(ctx, name, flat[2 * top], flat[2 * top + 1] - 16, colours);
  }
}

// The error of every moment (mean over individuals) as an area, and a mark where the clip stands.
function drawStrip(ctx, width, height, errors, at, colours) {
  ctx.clearRect(0, 0, width, height);
  if (!errors || errors.length < 2) return;
  const most = Math.max(...errors.filter((e) => e >= 0), 1e-9), inset = 8, span = width - 2 * inset;
  ctx.fillStyle = colours.faint;
  ctx.beginPath(); ctx.moveTo(inset, height);
  errors.forEach((e, k) => ctx.lineTo(inset + (k / (errors.length - 1)) * span, height - (e >= 0 ? e / most : 0) * (height - 3)));
  ctx.lineTo(width - inset, height); ctx.fill();
  ctx.fillStyle = colours.ink;
  ctx.fillRect(inset + (at / (errors.length - 1)) * span - 0.75, 0, 1.5, height);
}
