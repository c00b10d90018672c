/* The default experiment of an FMU on any platform: LIBRARY GUID STEPS H OUTPUT.. -> its rows. */

#include "fmi.h"

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)category, (void)status, (void)message;
}

static void row(fmi2Component unit, char **outputs) {
    for (; *outputs; outputs++) {
        fmi2ValueReference output = atoi(*outputs);
        double value;
        if (fmi2GetReal(unit, &output, 1, &value)) exit(3);
        printf("%.17g ", value);
    }
    printf("\n");
}

int main(int count, char **arguments) {
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component unit;
    int steps;
    double h;
    if (count < 5) return 2;
    load(arguments[1]);
    steps = atoi(arguments[3]), h = atof(arguments[4]);
    unit = fmi2Instantiate("unit", fmi2CoSimulation, arguments[2], "", &callbacks, fmi2False,
                           fmi2False);
    if (!unit || fmi2SetupExperiment(unit, fmi2False, 0.0, 0.0, fmi2False, 0.0)) return 3;
    if (fmi2EnterInitializationMode(unit) || fmi2ExitInitializationMode(unit)) return 3;
    row(unit, &arguments[5]);
    for (int n = 0; n < steps; n++) {
        if (fmi2DoStep(unit, n * h, h, fmi2True)) return 4;
        row(unit, &arguments[5]);
    }
    fmi2FreeInstance(unit);
    return 0;
}
