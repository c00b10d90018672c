// The functions of formulas, which are otherwise those of Math.
const { abs, atan2, cos, exp, hypot, log, max, min, pow, sin, sqrt } = Math;
const mod = (x, y) => ((x % y) + y) % y;
const where = (condition, yes, no) => (condition ? yes : no);
