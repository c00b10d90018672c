/* A host without Python that closes its libraries: OPENED CREATED CLOSED (LIBRARY RESOURCES GUID)...
   The first three arguments are orders such as ABC; what CLOSED leaves out stays open until the end. */

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"

#define H 1e-3
#define MOST 8
#define PATIENCE 60 /* s */

typedef struct {
    void *library;
    fmi2Component component;
    fmi2DoStepTYPE *step;
    fmi2FreeInstanceTYPE *free;
    int steps;
} Unit;

static void *need(void *pointer) {
    if (!pointer) {
        fprintf(stderr, "%s\n", dlerror());
        exit(2);
    }
    return pointer;
}

static void silent(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category, (void)message;
}

static const fmi2CallbackFunctions callbacks = {silent, calloc, free, NULL, NULL};

static void check(int status, const char *call) {
    if (status != fmi2OK) {
        fprintf(stderr, "%s returned %d\n", call, status);
        exit(1);
    }
}

static void create(Unit *unit, char **arguments) {
#define FIND(name) ((fmi2##name##TYPE *)need(dlsym(unit->library, "fmi2" #name)))
    unit->step = FIND(DoStep);
    unit->free = FIND(FreeInstance);
    unit->component = need(FIND(Instantiate)(arguments[0], fmi2CoSimulation, arguments[2], arguments[1],
                                             &callbacks, fmi2False, fmi2False));
    check(FIND(SetupExperiment)(unit->component, fmi2False, 0, 0, fmi2False, 0), "SetupExperiment");
    check(FIND(EnterInitializationMode)(unit->component), "EnterInitializationMode");
    check(FIND(ExitInitializationMode)(unit->component), "ExitInitializationMode");
}

int main(int count, char **arguments) {
    static Unit units[MOST];
    alarm(PATIENCE);
    for (char *letter = arguments[1]; *letter; letter++)
        units[*letter - 'A'].library = need(dlopen(arguments[4 + 3 * (*letter - 'A')], RTLD_LAZY));
    for (char *letter = arguments[2]; *letter; letter++)
        create(&units[*letter - 'A'], &arguments[4 + 3 * (*letter - 'A')]);
    for (char *letter = arguments[3];; letter++) {
        for (Unit *unit = units; unit < units + (count - 4) / 3; unit++)
            if (unit->component)
                check(unit->step(unit->component, H * unit->steps++, H, fmi2True), "DoStep");
        if (!*letter) break;
        Unit *unit = &units[*letter - 'A'];
        unit->free(unit->component);
        unit->component = NULL;
        if (dlclose(unit->library)) return 2;
    }
    puts("end of main");
    return 0;
}
