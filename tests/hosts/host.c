/* A host without Python: LIBRARY RESOURCES GUID J_REF J TAU_REF TAU W_REF STATUS -> w after every step.
   STATUS is what a refused step returns. */

#include "fmi.h"

#define STEPS 200
#define HALF (STEPS / 2)
#define H 1e-3
#define EXPECT(status, call) expect(__LINE__, status, call)

static void expect(int line, int wanted, int got) {
    if (got != wanted) {
        fprintf(stderr, "host.c:%d: %d instead of %d\n", line, got, wanted);
        exit(1);
    }
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    va_list values;
    (void)environment, (void)category;
    fprintf(stderr, "%s, status %d: ", instance, status);
    va_start(values, message);
    vfprintf(stderr, message, values);
    va_end(values);
    fprintf(stderr, "\n");
}

static fmi2Component unit;
static fmi2ValueReference J_ref, tau_ref, w_ref;
static double J, tau;
static int refused;

static void initialise(void) {
    EXPECT(fmi2OK, fmi2SetReal(unit, &J_ref, 1, &J));
    EXPECT(fmi2OK, fmi2SetupExperiment(unit, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    EXPECT(fmi2OK, fmi2EnterInitializationMode(unit));
    EXPECT(fmi2OK, fmi2SetReal(unit, &tau_ref, 1, &tau));
    EXPECT(fmi2OK, fmi2ExitInitializationMode(unit));
}

static void run(int from, int to, double *w) {
    for (int n = from; n < to; n++) {
        EXPECT(fmi2OK, fmi2DoStep(unit, n * H, H, fmi2True));
        EXPECT(fmi2OK, fmi2GetReal(unit, &w_ref, 1, &w[n]));
    }
}

static void fail(void) {
    EXPECT(refused, fmi2DoStep(unit, STEPS * H, -H, fmi2True));
}

int main(int count, char **arguments) {
    double w[STEPS], again[STEPS];
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2FMUstate state = NULL;
    EXPECT(10, count);
    load(arguments[1]);
    J_ref = atoi(arguments[4]), J = atof(arguments[5]);
    tau_ref = atoi(arguments[6]), tau = atof(arguments[7]);
    w_ref = atoi(arguments[8]), refused = atoi(arguments[9]);

    unit = fmi2Instantiate("conveyor", fmi2CoSimulation, arguments[3], arguments[2], &callbacks,
                           fmi2False, fmi2True);
    EXPECT(1, unit != NULL);
    initialise();
    run(0, HALF, w);
    EXPECT(fmi2OK, fmi2GetFMUstate(unit, &state));
    run(HALF, STEPS, w);
    for (int n = 0; n < STEPS; n++) printf("%.17g\n", w[n]);

    memcpy(again, w, sizeof w);
    memset(&again[HALF], 0, sizeof again / 2);
    EXPECT(fmi2OK, fmi2SetFMUstate(unit, state));
    run(HALF, STEPS, again);
    EXPECT(0, memcmp(w, again, sizeof w));

    fail();
    memset(&again[HALF], 0, sizeof again / 2);
    EXPECT(fmi2OK, fmi2SetFMUstate(unit, state));
    run(HALF, STEPS, again);
    EXPECT(0, memcmp(w, again, sizeof w));

    fail();
    memset(again, 0, sizeof again);
    EXPECT(fmi2OK, fmi2Reset(unit));
    initialise();
    run(0, STEPS, again);
    EXPECT(0, memcmp(w, again, sizeof w));

    EXPECT(fmi2OK, fmi2FreeFMUstate(unit, &state));
    EXPECT(fmi2OK, fmi2Terminate(unit));
    fmi2FreeInstance(unit);
    return dlclose(library);
}
