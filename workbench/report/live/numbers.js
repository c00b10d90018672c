"use strict";
// What the live part of a page computes with; each function does what its namesake in Python does.

const last = list => list[list.length - 1];
const range = (n, make = k => k) => {
  const made = [];
  for (let k = 0; k < n; k++) made.push(make(k));
  return made;
};
const linspace = (first, end, n) => range(n, k => k === n - 1 ? end : first + k * ((end - first) / (n - 1)));
const geomspace = (first, end, n) =>
  range(n, k => k === n - 1 ? end : k ? first * Math.pow(end / first, k / (n - 1)) : first);
const most = (list, of = x => x) => {
  let top = -Infinity;
  for (const x of list) {
    const value = of(x);
    if (Number.isNaN(value)) return NaN;
    if (value > top) top = value;
  }
  return top;
};
const searchsorted = (list, x) => {
  let low = 0, high = list.length;
  while (low < high) { const k = (low + high) >> 1; if (list[k] < x) low = k + 1; else high = k; }
  return low;
};

// x of A x = b for the columns b, of a symmetric positive A whose rows are filled up to the diagonal.
const solve = (A, columns) => {
  const n = A.length;
  for (let i = 0; i < n; i++) for (let j = 0; j <= i; j++) {
    const a = A[i], b = A[j];
    let rest = a[j], more = 0, k = 0;
    for (; k < j - 1; k += 2) { rest -= a[k] * b[k]; more += a[k + 1] * b[k + 1]; }
    if (k < j) rest -= a[k] * b[k];
    a[j] = i === j ? Math.sqrt(rest - more) : (rest - more) / b[j];
  }
  for (const x of columns) {
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < i; k++) x[i] -= A[i][k] * x[k];
      x[i] /= A[i][i];
    }
    for (let i = n - 1; i >= 0; i--) {
      for (let k = i + 1; k < n; k++) x[i] -= A[k][i] * x[k];
      x[i] /= A[i][i];
    }
  }
  return columns;
};

// The least x of least |A x - b|: A (m, n), b (m, columns); directions below rcond are left out.
const lstsq = (A, b, rcond) => {
  const n = A[0].length, U = A.map(row => [...row]), V = range(n, i => range(n, j => +(i === j)));
  const turn = (M, p, q, c, s) => {
    for (const row of M) [row[p], row[q]] = [c * row[p] - s * row[q], s * row[p] + c * row[q]];
  };
  const dot = (p, q) => U.reduce((sum, row) => sum + row[p] * row[q], 0);
  for (let sweep = 0, moved = true; moved && sweep < 60; sweep++) {
    moved = false;
    for (let p = 0; p < n; p++) for (let q = p + 1; q < n; q++) {
      const a = dot(p, p), d = dot(q, q), off = dot(p, q);
      if (Math.abs(off) <= 1e-16 * Math.sqrt(a * d)) continue;
      moved = true;
      const zeta = (d - a) / (2 * off), t = (zeta < 0 ? -1 : 1) / (Math.abs(zeta) + Math.hypot(1, zeta));
      const c = 1 / Math.hypot(1, t);
      turn(U, p, q, c, c * t);
      turn(V, p, q, c, c * t);
    }
  }
  const sizes = range(n, k => Math.sqrt(dot(k, k))), least = rcond * most(sizes);
  const shares = range(n, k => b[0].map((_, j) =>
    sizes[k] > least ? U.reduce((sum, row, i) => sum + row[k] * b[i][j], 0) / sizes[k] ** 2 : 0));
  return V.map(row => b[0].map((_, j) => row.reduce((sum, v, k) => sum + v * shares[k][j], 0)));
};

// The polynomial through points, as a function.
const through = (x, y) => {
  const weight = new Float64Array(x.length).fill(1);
  for (let k = 0; k < x.length; k++) for (let j = 0; j < x.length; j++) if (j !== k) weight[k] /= x[k] - x[j];
  return at => {
    let over = 0, under = 0;
    for (let k = 0; k < x.length; k++) {
      if (at === x[k]) return y[k];
      const share = weight[k] / (at - x[k]);
      over += share * y[k];
      under += share;
    }
    return over / under;
  };
};

// Cubics between knots x, a s^3 + b s^2 + c s + d from each knot on; `parts` are all a, all b, all c, all d.
class Cubics {
  constructor(x, parts) { this.x = x; this.parts = parts; }

  // The spline through points whose third derivative is also continuous beside both ends.
  static spline(x, y) {
    const n = x.length, h = new Float64Array(n - 1), m = new Float64Array(n - 1), d0 = new Float64Array(n - 1);
    for (let k = 0; k < n - 1; k++) { h[k] = x[k + 1] - x[k]; m[k] = (y[k + 1] - y[k]) / h[k]; d0[k] = y[k]; }
    if (n < 4) {
      const curve = n < 3 ? 0 : (m[1] - m[0]) / (x[2] - x[0]);
      return new Cubics(x, [h.map(() => 0), h.map(() => curve), m.map((slope, k) => slope - curve * h[k]), d0]);
    }
    const low = new Float64Array(n), mid = new Float64Array(n), up = new Float64Array(n), s = new Float64Array(n);
    for (let k = 1; k < n - 1; k++) {
      low[k] = h[k]; mid[k] = 2 * (h[k - 1] + h[k]); up[k] = h[k - 1];
      s[k] = 3 * (h[k] * m[k - 1] + h[k - 1] * m[k]);
    }
    let d = x[2] - x[0];
    mid[0] = h[1]; up[0] = d;
    s[0] = ((h[0] + 2 * d) * h[1] * m[0] + h[0] ** 2 * m[1]) / d;
    d = x[n - 1] - x[n - 3];
    mid[n - 1] = h[n - 3]; low[n - 1] = d;
    s[n - 1] = (h[n - 2] ** 2 * m[n - 3] + (2 * d + h[n - 2]) * h[n - 3] * m[n - 2]) / d;
    for (let k = 1; k < n; k++) {
      const factor = low[k] / mid[k - 1];
      mid[k] -= factor * up[k - 1];
      s[k] -= factor * s[k - 1];
    }
    s[n - 1] /= mid[n - 1];
    for (let k = n - 2; k >= 0; k--) s[k] = (s[k] - up[k] * s[k + 1]) / mid[k];
    const parts = [h, m, s.slice(0, n - 1), d0];
    for (let k = 0; k < n - 1; k++) {
      const step = h[k], slope = m[k], bend = (s[k] + s[k + 1] - 2 * slope) / step;
      h[k] = bend / step;
      m[k] = (slope - s[k]) / step - bend;
    }
    return new Cubics(x, parts);
  }

  at(x) {
    const k = Math.min(Math.max(searchsorted(this.x, x) - 1, 0), this.x.length - 2), [a, b, c, d] = this.parts, s = x - this.x[k];
    return ((a[k] * s + b[k]) * s + c[k]) * s + d[k];
  }

  derivative() {
    const [a, b, c] = this.parts;
    return new Cubics(this.x, [a.map(() => 0), a.map(x => 3 * x), b.map(x => 2 * x), c]);
  }

  roots(level = 0) {
    const found = [], [as, bs, cs, ds] = this.parts, many = as.length;
    for (let k = 0; k < many; k++) {
      const a = as[k], b = bs[k], c = cs[k], d = ds[k], long = this.x[k + 1] - this.x[k];
      if (Math.abs(d - level) > ((Math.abs(a) * long + Math.abs(b)) * long + Math.abs(c)) * long) continue;
      const cuts = [0, long], value = s => ((a * s + b) * s + c) * s + (d - level);
      const inner = b * b - 3 * a * c;
      if (inner > 0) {
        const q = -(b + (b < 0 ? -1 : 1) * Math.sqrt(inner));
        for (const s of [q / (3 * a), c / q]) if (s > 0 && s < long) cuts.push(s);
      }
      cuts.sort((p, q) => p - q);
      for (let j = 1; j < cuts.length; j++) {
        let low = cuts[j - 1], high = cuts[j], first = value(low);
        const end = value(high), closed = j === cuts.length - 1 && k === many - 1;
        if (first === 0 ? j > 1 : !(first < 0 ? end > 0 || (closed && end === 0) : end < 0 || (closed && end === 0))) continue;
        while (first !== 0) {
          const s = (low + high) / 2;
          if (s <= low || s >= high) break;
          if ((value(s) < 0) === (first < 0)) low = s; else high = s;
        }
        found.push(this.x[k] + (first === 0 ? low : high));
      }
    }
    return found;
  }
}

// Complex amplitudes of the orders 1..highest of columns x over phi, Im(X exp(i k phi)), fitted
// together with the mean; of each column a list. The normal equations are sums of exp(i m phi).
const harmonics = (phi, columns, highest) => {
  const size = 2 * highest + 1, real = new Float64Array(size), imag = new Float64Array(size);
  const right = columns.map(() => new Float64Array(size)), [re, im, re2, im2] = range(4, () => new Float64Array(size));
  for (let n = 0; n < phi.length; n += 2) {
    const more = n + 1 < phi.length, p = phi[n], q = more ? phi[n + 1] : 0;
    const c = Math.cos(p), s = Math.sin(p), c2 = Math.cos(q), s2 = Math.sin(q);
    let a = 1, b = 0, a2 = +more, b2 = 0;
    for (let m = 0; m <= highest; m++) {
      re[m] = a; im[m] = b; re2[m] = a2; im2[m] = b2;
      let t = a * c - b * s; b = a * s + b * c; a = t;
      t = a2 * c2 - b2 * s2; b2 = a2 * s2 + b2 * c2; a2 = t;
    }
    a = re[highest]; b = im[highest]; a2 = re2[highest]; b2 = im2[highest];
    for (let m = 0; m <= highest; m++) { real[m] += re[m] + re2[m]; imag[m] += im[m] + im2[m]; }
    for (let m = 1; m <= highest; m++) {
      real[highest + m] += re[m] * a - im[m] * b + (re2[m] * a2 - im2[m] * b2);
      imag[highest + m] += re[m] * b + im[m] * a + (re2[m] * b2 + im2[m] * a2);
    }
    for (let j = 0; j < columns.length; j++) {
      const x = columns[j][n], y = more ? columns[j][n + 1] : 0, sums = right[j];
      sums[0] += x + y;
      for (let m = 1; m <= highest; m++) { sums[m] += im[m] * x + im2[m] * y; sums[highest + m] += re[m] * x + re2[m] * y; }
    }
  }
  const A = range(size, i => {
    const row = new Float64Array(i + 1);
    if (i <= highest) {
      row[0] = i ? imag[i] : real[0];
      for (let j = 1; j <= i; j++) row[j] = (real[i - j] - real[i + j]) / 2;
      return row;
    }
    const m = i - highest;
    row[0] = real[m];
    for (let j = 1; j <= highest; j++) row[j] = (imag[j + m] + (j < m ? -imag[m - j] : imag[j - m])) / 2;
    for (let j = 1; j <= m; j++) row[highest + j] = (real[m - j] + real[m + j]) / 2;
    return row;
  });
  return solve(A, right).map(fit => range(highest, k => [fit[k + 1], fit[k + 1 + highest]]));
};

// A number as "%.6g" writes it.
const six = (value, digits = 6) => {
  if (!value) return String(value);
  const near = Number(value.toPrecision(digits)), size = Math.abs(near);
  if (size >= 1e-4 && size < 10 ** digits) return String(near);
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  const trimmed = text => text.includes(".") ? text.replace(/\.?0+$/, "") : text;
  if (exponent < -4 || exponent >= digits) return power(`${trimmed(mantissa)}e${exponent}`);
  return trimmed(value.toFixed(digits - 1 - exponent));
};

// A number as Python writes a float.
const written = x => x && Math.abs(x) < 1e-4 ? power(x.toExponential()) : Number.isInteger(x) ? x.toFixed(1) : power(String(x));

const power = text => text.replace(/e([+-])(\d)$/, "e$10$2");
