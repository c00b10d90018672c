/* A component for WebAssembly: a flat interface of numbers over fmi2.c, which needs no imports.

   MODEL is the generated file. Variables are numbers that `find` knows by the name in `text`; a
   status is that of FMI. What the instance has to say since it was last asked stands in `text`. */

#define FMI2_FUNCTION_PREFIX flat_
#include MODEL

#define FLAT(name) __attribute__((export_name(#name)))

static char message_buffer[2 * TEXT_SIZE];

static void collect_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                 fmi2String category, fmi2String form, ...) {
    size_t length = strlen(message_buffer);
    va_list values;
    (void)environment, (void)name, (void)status, (void)category;
    if (length > sizeof message_buffer - TEXT_SIZE) return;
    va_start(values, form);
    if (length) message_buffer[length++] = '\n';
    vsnprintf(message_buffer + length, sizeof message_buffer - length, form, values);
    va_end(values);
}

static const fmi2CallbackFunctions callbacks = {collect_message, calloc, free, NULL, NULL};

FLAT(text) char *flat_text(void) { return message_buffer; }

FLAT(create) fmi2Component flat_create(void) {
    return flat_fmi2Instantiate("i", fmi2CoSimulation, GUID, "", &callbacks, fmi2False, fmi2True);
}

FLAT(find) int flat_find(void) {
    int k = VARIABLES - 1;
    while (k >= 0 && strcmp(variables[k].name, message_buffer)) k--;
    message_buffer[0] = '\0';
    return k;
}

FLAT(set) fmi2Status flat_set(fmi2Component i, fmi2ValueReference k, double value) {
    const fmi2Integer store_count = (fmi2Integer)value;
    if (has_type(&variables[k], "Real")) return flat_fmi2SetReal(i, &k, 1, &value);
    if (has_type(&variables[k], "Boolean")) return flat_fmi2SetBoolean(i, &k, 1, &store_count);
    return flat_fmi2SetInteger(i, &k, 1, &store_count);
}

FLAT(get) double flat_get(fmi2Component i, fmi2ValueReference k) {
    double value = NAN;
    fmi2Integer store_count;
    if (has_type(&variables[k], "Real")) return flat_fmi2GetReal(i, &k, 1, &value), value;
    if (has_type(&variables[k], "Boolean") ? flat_fmi2GetBoolean(i, &k, 1, &store_count)
                                        : flat_fmi2GetInteger(i, &k, 1, &store_count))
        return NAN;
    return store_count;
}

FLAT(enter) fmi2Status flat_enter(fmi2Component i) { return flat_fmi2EnterInitializationMode(i); }

FLAT(begin) fmi2Status flat_begin(fmi2Component i) { return flat_fmi2ExitInitializationMode(i); }

FLAT(step) fmi2Status flat_step(fmi2Component i, double t, double h) {
    return flat_fmi2DoStep(i, t, h, fmi2True);
}

FLAT(reset) fmi2Status flat_reset(fmi2Component i) { return flat_fmi2Reset(i); }

FLAT(save) fmi2FMUstate flat_save(fmi2Component i) {
    fmi2FMUstate state = NULL;
    return flat_fmi2GetFMUstate(i, &state) ? NULL : state;
}

FLAT(restore) fmi2Status flat_restore(fmi2Component i, fmi2FMUstate state) {
    return flat_fmi2SetFMUstate(i, state);
}

FLAT(forget) fmi2Status flat_forget(fmi2Component i, fmi2FMUstate state) {
    return flat_fmi2FreeFMUstate(i, &state);
}
