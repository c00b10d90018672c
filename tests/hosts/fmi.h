/* All functions of an FMU by their names, taken from the library that load() opens. */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
#define dlopen(path, mode) (void *)LoadLibraryA(path)
#define dlsym (void *)GetProcAddress
#define dlclose FreeLibrary
#define dlerror() "no such library or function"
#else
#include <dlfcn.h>
#endif

#define FUNCTIONS(X) \
    X(GetReal) X(SetReal) X(GetInteger) X(SetInteger) X(GetBoolean) X(SetBoolean) X(GetString) \
    X(SetString) X(GetRealOutputDerivatives) X(SetRealInputDerivatives) \
    X(GetDirectionalDerivative) X(GetFMUstate) X(SetFMUstate) X(FreeFMUstate) X(SetupExperiment) \
    X(EnterInitializationMode) X(ExitInitializationMode) X(Terminate) X(DoStep) X(CancelStep) \
    X(GetStatus) X(GetRealStatus) X(GetIntegerStatus) X(GetBooleanStatus) X(GetStringStatus) \
    X(SetDebugLogging) X(SerializedFMUstateSize) X(SerializeFMUstate) X(DeSerializeFMUstate) \
    X(Instantiate) X(FreeInstance) X(Reset) X(GetTypesPlatform) X(GetVersion)
#define EXCHANGE(X) \
    X(EnterEventMode) X(NewDiscreteStates) X(EnterContinuousTimeMode) \
    X(CompletedIntegratorStep) X(SetTime) \
    X(SetContinuousStates) X(GetDerivatives) X(GetEventIndicators) X(GetContinuousStates) \
    X(GetNominalsOfContinuousStates)
#define DECLARE(name) static fmi2##name##TYPE *fmi2##name;
#define LOAD(name) fmi2##name = (fmi2##name##TYPE *)need(dlsym(library, "fmi2" #name));
#define TRY(name) fmi2##name = (fmi2##name##TYPE *)dlsym(library, "fmi2" #name);

FUNCTIONS(DECLARE)
EXCHANGE(DECLARE)
static void *library;

static void *need(void *pointer) {
    if (!pointer) {
        fprintf(stderr, "%s\n", dlerror());
        exit(2);
    }
    return pointer;
}

#ifndef FMI3
static void load(const char *path) {
    library = need(dlopen(path, RTLD_NOW | RTLD_LOCAL));
    FUNCTIONS(LOAD)
    EXCHANGE(TRY) /* which not every FMU has */
}
#endif
