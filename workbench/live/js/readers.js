// Readers of columns: numbers from rows { t, x, angle }, which a test compares with cosim.metrics.
const TURN = 2 * Math.PI;

// The second derivative of y over x between rows k - 1 and k: the smaller of those at both rows, and 0
// where they differ in sign or x does not grow, as at a jump.
const curvature = (y, x, k) => {
  const slope = (n) => (y[n] - y[n - 1]) / (x[n] - x[n - 1]);
  const at = (n) => (2 * (slope(n + 1) - slope(n))) / (x[n + 1] - x[n - 1]);
  const before = at(Math.max(1, Math.min(k - 1, x.length - 2)));
  const after = at(Math.max(1, Math.min(k, x.length - 2)));
  if (!(before * after > 0 && Number.isFinite(before) && Number.isFinite(after))) return 0;
  return Math.abs(before) < Math.abs(after) ? before : after;
};

// The integral of y over x, by the trapezoidal rule less what the curvature adds to it.
const integral = (y, x) => {
  let sum = 0;
  for (let k = 1; k < x.length; k++) {
    const step = x[k] - x[k - 1];
    sum += (step * (y[k] + y[k - 1])) / 2 - (step ** 3 * curvature(y, x, k)) / 12;
  }
  return sum;
};

// The complex amplitude [re, im] of an order, x = Im(X exp(i k angle)), over a revolution.
const wave = ({ x, angle, order }) => {
  const scale = 2 / (angle.at(-1) - angle[0]);
  const sine = x.map((y, k) => y * Math.sin(order * angle[k]));
  const cosine = x.map((y, k) => y * Math.cos(order * angle[k]));
  return [scale * integral(sine, angle), scale * integral(cosine, angle)];
};

// The largest value and its time: of the parabola through the three highest rows where the curve bends there.
const peak = ({ t, x }) => {
  let k = 0;
  for (let n = 1; n < x.length; n++) if (x[n] > x[k]) k = n;
  if (k < 2 || k > x.length - 3) return { value: x[k], time: t[k] };
  const bend = (n) => 2 * x[n] - x[n - 1] - x[n + 1];
  const slope = x[k + 1] - x[k - 1];
  const room = Math.min(slope ** 2 / (8 * bend(k)), bend(k - 1) / 8, bend(k + 1) / 8);
  const shift = room > 0 ? slope / (2 * bend(k)) : 0;
  const step = shift < 0 ? t[k] - t[k - 1] : t[k + 1] - t[k];
  return { value: x[k] + Math.max(0, room), time: t[k] + shift * step };
};

const turned = (rows) => ({ ...rows, x: rows.x.map((y) => -y) });

const readers = {
  last: ({ x }) => x.at(-1),
  change: ({ x }) => x.at(-1) - x[0],
  max: (rows) => peak(rows).value,
  min: (rows) => -peak(turned(rows)).value,
  time_of_max: (rows) => peak(rows).time,
  time_of_min: (rows) => peak(turned(rows)).time,
  mean: ({ t, x }) => integral(x, t) / (t.at(-1) - t[0]),
  first_crossing: ({ t, x, level }) => {
    const over = x.map((y) => y - level);
    const k = over.findIndex((y, n) => n < x.length - 1 && y !== 0 && y * over[n + 1] <= 0);
    return k < 0 ? NaN : t[k] + ((t[k + 1] - t[k]) * over[k]) / (over[k] - over[k + 1]);
  },
  amplitude: (rows) => Math.hypot(...wave(rows)),
  phase: (rows) => {
    const [re, im] = wave(rows);
    return (Math.atan2(im, re) * 180) / Math.PI;
  },
};

// The rows from a time on, the first of them between two rows.
const since = (rows, begin) => {
  const { t } = rows;
  if (!(begin > t[0])) return rows;
  const k = t.findIndex((now) => now > begin);
  if (k < 0) return rows;
  const share = (begin - t[k - 1]) / (t[k] - t[k - 1]);
  const cut = (column) => {
    const later = Float64Array.from(column.subarray(k - 1));
    const sag = (curvature(column, t, k) * (begin - t[k - 1]) * (t[k] - begin)) / 2;
    later[0] += share * (column[k] - column[k - 1]) - sag;
    return later;
  };
  return { ...rows, t: cut(t), x: cut(rows.x), angle: cut(rows.angle) };
};

// The time at which the last revolution begins; NaN if there is no whole one.
const revolution = (t, angle) => {
  const begin = angle.at(-1) - TURN;
  const k = angle.findLastIndex((phi) => phi <= begin);
  return k < 0 ? NaN : t[k] + ((t[k + 1] - t[k]) * (begin - angle[k])) / (angle[k + 1] - angle[k]);
};
