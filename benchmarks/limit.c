/* The drive by hand in one program, without FMI, error control or generality: what a step of motor
   and conveyor with so many evaluations of the right-hand side costs at least.
   usage: limit STEPS SUBSTEPS, prints seconds per communication step of 1 ms. */

#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static const double A = 8000.0, B = 199.8, T = 0.0625;
static const double J = 0.49, r = 0.01, m = 200.0, d = 4000.0, c = 720000.0;

/* near: an angle less than 0.1 rad away, its sine and its cosine. */
static void rates(const double *near, const double *x, double tau, double *dx)
{
    double a = x[0] - near[0], b = a * a, e = b * b;
    double sine = a * ((1 - b * (1.0 / 6)) + e * (1.0 / 120 - b * (1.0 / 5040)));
    double cosine = (1 - b * 0.5) + e * ((1.0 / 24 - b * (1.0 / 720)) + e * (1.0 / 40320));
    double s = r * (near[1] * cosine + near[2] * sine), ds = r * (near[2] * cosine - near[1] * sine);
    double w = x[1];
    double theta = J + m * ds * ds;
    double load = c * s * ds + d * ds * ds * w - m * ds * s * w * w;
    dx[0] = w;
    dx[1] = (tau - load) / theta;
}

/* A step of Dormand and Prince of order 5, seven evaluations with the slope at its end. */
static void conveyor(double *x, double tau, double h)
{
    static const double a[6][6] = {
        {1.0 / 5},
        {3.0 / 40, 9.0 / 40},
        {44.0 / 45, -56.0 / 15, 32.0 / 9},
        {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
        {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
        {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
    };
    double k[7][2], y[2], near[3] = {x[0], sin(x[0]), cos(x[0])};
    rates(near, x, tau, k[0]);
    for (int i = 0; i < 6; i++) {
        y[0] = x[0], y[1] = x[1];
        for (int j = 0; j <= i; j++) y[0] += h * a[i][j] * k[j][0], y[1] += h * a[i][j] * k[j][1];
        rates(near, y, tau, k[i + 1]);
    }
    x[0] = y[0], x[1] = y[1];
}

int main(int argc, char **argv)
{
    if (argc != 3) return 2;
    long steps = atol(argv[1]), substeps = atol(argv[2]);
    double x[2] = {0.0, 40.0}, M = 8.0, h = 1e-3;
    struct timespec begin, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    for (long n = 0; n < steps; n++) {
        double w = x[1], tau = M, level = A - B * w;
        M = level + (M - level) * exp(-h / T);
        for (long k = 0; k < substeps; k++) conveyor(x, tau, h / substeps);
    }
    clock_gettime(CLOCK_MONOTONIC, &end);
    fprintf(stderr, "%.17g %.17g %.17g\n", x[0], x[1], M);
    printf("%.17g\n", (end.tv_sec - begin.tv_sec + 1e-9 * (end.tv_nsec - begin.tv_nsec)) / steps);
    return 0;
}
