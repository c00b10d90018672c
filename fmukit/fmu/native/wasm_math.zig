//! Functions of <math.h> that Zig's C library for WebAssembly takes from Zig's own, for a module
//! that is linked without this library.

const math = @import("std").math;

export fn acos(x: f64) f64 {
    return math.acos(x);
}

export fn asin(x: f64) f64 {
    return math.asin(x);
}

export fn atan(x: f64) f64 {
    return math.atan(x);
}

export fn cosh(x: f64) f64 {
    return math.cosh(x);
}

export fn log1p(x: f64) f64 {
    return math.log1p(x);
}

export fn tanh(x: f64) f64 {
    return math.tanh(x);
}
