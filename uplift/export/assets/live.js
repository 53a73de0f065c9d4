// Poses as they come: each message holds a frame, its keypoints and its poses; the newest is drawn.
const meta = JSON.parse(document.getElementById('data').textContent);
const byId = (id) => document.getElementById(id);
const style = getComputedStyle(document.documentElement);
const SIDES = ['--middle', '--left', '--right'];
const colour = (name) => style.getPropertyValue(name).trim();
const view = { yaw: -0.5, pitch: 0.16 };
let newest = null, photo = null, due = false, came = 0, rate = 0;

function context(id) {
  const canvas = byId(id), box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  const [wide, high] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
  if (canvas.width !== wide || canvas.height !== high) { canvas.width = wide; canvas.height = high; }
  const ctx = canvas.getContext('2d');
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, box.width, box.height);
  ctx.lineCap = 'round';
  return [ctx, box.width, box.height];
}

// Bones far to near; a joint without a number has no bone.
function figure(ctx, points, rimmed) {
  const drawn = meta.bones.map(([a, b], n) => ({ a: points[a], b: points[b], side: meta.boneSides[n] })).filter(({ a, b }) => a && b);
  drawn.sort((one, other) => other.a[2] + other.b[2] - one.a[2] - one.b[2]);
  for (const rim of rimmed ? [true, false] : [false]) {
    for (const { a, b, side } of drawn) {
      ctx.lineWidth = rim ? 6 : 4; ctx.strokeStyle = rim ? colour('--paper') : colour(SIDES[side]);
      ctx.beginPath(); ctx.moveTo(a[0], a[1]); ctx.lineTo(b[0], b[1]); ctx.stroke();
    }
  }
}

function drawFlat() {
  const [ctx, width, height] = context('flat'), [W, H] = newest.size, scale = Math.min(width / W, height / H);
  const left = (width - W * scale) / 2, top = (height - H * scale) / 2;
  if (photo) ctx.drawImage(photo, left, top, W * scale, H * scale);
  for (const { keypoints } of newest.people) figure(ctx, keypoints.map((at) => at && [left + at[0] * scale, top + at[1] * scale, 0]), true);
}

function drawDeep() {
  const [ctx, width, height] = context('deep'), [W, H] = newest.size, scale = Math.min(width / W, height / H);
  const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
  for (const { pose } of newest.people) {
    figure(ctx, pose.map(([x, y, z]) => {
      const across = cy * x + sy * z, away = cy * z - sy * x;
      return [width / 2 + across * scale, height / 2 + (cp * y - sp * away) * scale, cp * away + sp * y];
    }), false);
  }
}

function draw() {
  due = false;
  if (!newest) return;
  drawFlat();
  drawDeep();
  byId('flat-note').textContent = `frame ${newest.frame} · ${rate.toFixed(0)} a second`;
}

function paint() { if (!due) { due = true; requestAnimationFrame(draw); } }

async function receive(event) {
  const message = JSON.parse(event.data), now = performance.now();
  rate = came ? 0.9 * rate + 100 / Math.max(1, now - came) : 0;
  came = now;
  const bytes = Uint8Array.from(atob(message.jpeg), (letter) => letter.charCodeAt(0));
  const bitmap = await createImageBitmap(new Blob([bytes], { type: 'image/jpeg' }));
  if (newest && newest.frame > message.frame) return;
  photo?.close();
  [newest, photo] = [message, bitmap];
  document.documentElement.dataset.ready = 'yes';
  paint();
}

const source = new EventSource('stream');
source.onmessage = receive;
source.addEventListener('end', () => { source.close(); byId('deep-note').textContent = 'it has ended'; });
addEventListener('resize', paint);
byId('theme').onclick = () => { const { dataset } = document.documentElement; dataset.theme = dataset.theme === 'dark' ? 'light' : 'dark'; paint(); };
byId('deep').onpointerdown = (event) => event.target.setPointerCapture(event.pointerId);
byId('deep').onpointermove = (event) => {
  if (!event.buttons) return;
  view.yaw -= event.movementX * 0.008; view.pitch = Math.max(-1.5, Math.min(1.5, view.pitch + event.movementY * 0.008));
  paint();
};
byId('deep').ondblclick = () => { Object.assign(view, { yaw: 0, pitch: 0 }); paint(); };
window.uplift = { state: () => ({ frame: newest?.frame, people: newest?.people.length, rate }) };
