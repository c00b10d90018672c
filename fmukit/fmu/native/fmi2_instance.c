/* Instances: what may be called when, and what follows from their state. */

static double *part(Instance *i, int first) { return i->state.values + first; }

static void restart(Instance *i) {
    memset(&i->state, 0, sizeof i->state);
    memset(&i->context, 0, sizeof i->context);
    for (int k = 0; k < VARIABLES; k++) i->state.values[k] = variables[k].start;
    memcpy(i->state.before, part(i, FIRST_INPUT), INPUTS * sizeof(double));
    memcpy(i->state.end, part(i, FIRST_INPUT), INPUTS * sizeof(double));
    i->state.stale = 1.0;
    i->state.phase = INSTANTIATED;
    i->state.kind = i->kind;
}

/* Hosts take a message as a printf format. */
static void tell(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name,
                 fmi2Status status, const char *category, const char *message) {
    char text[2 * TEXT + 1], *at = text;
    if (!logger) return;
    for (; *message && at < text + sizeof text - 2; message++) {
        if (FORMATS && *message == '%') *at++ = '%';
        *at++ = *message;
    }
    *at = '\0';
    logger(environment, name, status, category, text);
}

/* Hand on the notes of a call, or its failure with the notes before it. */
static fmi2Status told(Instance *i) {
    Context *c = &i->context;
    fmi2Status status = fmi2OK;
    char text[TEXT];
    size_t length = 0;
    if (c->dropped) {
        put_value(c->notes, &c->notes_length, "Integer", (double)c->dropped);
        put(c->notes, &c->notes_length, " more messages are left out\n");
    }
    if (c->failed) {
        put(text, &length, i->name);
        put(text, &length, ": ");
        for (char *end, *line = c->notes; *line && length < TEXT / 2; line = end + 1) {
            *(end = strchr(line, '\n')) = '\0';
            put(text, &length, i->name), put(text, &length, ": ");
            put(text, &length, line), put(text, &length, "; ");
        }
        put(text, &length, c->why ? c->why : c->reason);
    }
    if (c->failed && c->discarded) {
        status = fmi2Discard;
        if (i->logging)
            tell(i->logger, i->environment, i->name, status, "logStatusWarning", text);
    } else if (c->failed) {
        for (int k = FIRST_STATE; k < VARIABLES; k++)
            if (!strcmp(variables[k].kind, "Real")) i->state.values[k] = NAN;
        i->state.stale = 0.0;
        i->state.phase = FAILED;
        status = fmi2Error;
        tell(i->logger, i->environment, i->name, status, "logStatusError", text);
    } else {
        for (char *end, *line = c->notes; i->logging && *line; line = end + 1) {
            if (!(end = strchr(line, '\n'))) break;
            *end = '\0';
            length = 0;
            put(text, &length, i->name), put(text, &length, ": "), put(text, &length, line);
            tell(i->logger, i->environment, i->name, fmi2Warning, "logStatusWarning", text);
        }
    }
    c->notes[c->notes_length = c->dropped = 0] = '\0';
    clear(c);
    return status;
}

/* End a call. */
INLINE fmi2Status finish(Instance *i) {
    return i->context.failed || i->context.notes_length ? told(i) : fmi2OK;
}

/* The kind of instance that has this phase. */
static int kind_of(int phase) {
    if (phase == STEPPING) return COSIMULATION;
    return phase == INTEGRATING || (phase == AT_EVENT && !EVENTS_IN_STEPS) ? EXCHANGE : EITHER;
}

static void refuse(Instance *i, const char *call, int kind, int first, int last) {
    Context *c = &i->context;
    const char *between = ", only ";
    if (kind != EITHER && kind != i->kind) {
        fail(c, "%s is for %s, but this instance is for %s", call, KINDS[kind], KINDS[i->kind]);
        return;
    }
    fail(c, "%s is not allowed %s", call, PHASES[(int)i->state.phase]);
    for (int phase = first; phase <= last; phase++)
        if (kind_of(phase) == EITHER || kind_of(phase) == i->kind)
            append(c, "%s%s", between, PHASES[phase]), between = " or ";
}

/* Whether a call is in order: for this kind of instance, in the phases from the first to the last. */
INLINE int allowed(Instance *i, const char *call, int kind, int first, int last) {
    const double phase = i->state.phase;
    if (phase >= first && phase <= last && (kind == EITHER || kind == i->kind)) return 1;
    refuse(i, call, kind, first, last);
    return 0;
}

INLINE void check_finite(Context *c, const Variable *v, double value) {
    if (!is_finite(value) && !strcmp(v->kind, "Real"))
        fail(c, "%s = %v must be a finite number", v->name, v, value);
}

/* A derivative of a variable, by time or by another one. */
INLINE double derivative(Context *c, const Variable *v, double value) {
    if (!is_finite(value)) fail(c, "the derivative of %s = %r must be a finite number", v->name, value);
    return value;
}

/* The inputs of this instant; after a step, those at its end. */
static const double *present(Instance *i) {
    const int stepping = i->kind == COSIMULATION && i->state.phase != AT_EVENT;
    return stepping ? i->state.end : part(i, FIRST_INPUT);
}

/* What an integrator tries may fail. */
static void evaluated(Instance *i) {
    i->context.discarded = i->context.failed && i->state.phase == INTEGRATING;
}

/* Calculate the outputs from the state and the inputs of this instant. */
static void refresh(Instance *i) {
    Context *c = &i->context;
    State *s = &i->state;
    double *x = part(i, FIRST_STATE), result[SOME(STATES + OUTPUTS)];
    if (s->phase == INITIALIZING) {
        model_check(c, s->values);
        c->notes[c->notes_length = c->dropped = 0] = '\0';
        if (c->failed) return;
        memcpy(s->end, part(i, FIRST_INPUT), INPUTS * sizeof(double));
        model_initial(c, s->values, s->time, x, s->end, result);
        if (!c->failed) memcpy(x, result, STATES * sizeof *x);
    } else {
        model_outputs(c, s->values, s->time, x, present(i), result + STATES);
    }
    for (int k = 0; k < OUTPUTS; k++) check_finite(c, &variables[FIRST_OUTPUT + k], result[STATES + k]);
    evaluated(i);
    if (c->failed) return;
    memcpy(part(i, FIRST_OUTPUT), result + STATES, OUTPUTS * sizeof *result);
    s->stale = 0.0;
}

/* During initialisation, bring what has been set up to date. */
static int settled(Instance *i) {
    if (i->state.phase == INITIALIZING && i->state.stale != 0.0) refresh(i);
    return !i->context.failed;
}

/* The derivatives of the continuous states at this instant. */
static void derive(Instance *i, double *result) {
    Context *c = &i->context;
    State *s = &i->state;
    if (!settled(i)) return;
    model_derivatives(c, s->values, s->time, part(i, FIRST_STATE), present(i), result);
    for (int k = 0; k < DERIVATIVES; k++)
        check_finite(c, &variables[FIRST_DERIVATIVE + k], result[k]);
    evaluated(i);
}

/* The guards at this instant; an event is where one falls below zero. */
static void guards(Instance *i, double *result) {
    State *s = &i->state;
    if (!settled(i)) return;
    model_guards(&i->context, s->values, s->time, part(i, FIRST_STATE), present(i), result);
    for (int k = 0; k < INDICATORS; k++)
        if (!is_finite(result[k]))
            fail(&i->context, "event indicator %d = %r must be a finite number", k + 1.0, result[k]);
    evaluated(i);
}

/* The first guard that is below zero, -1 if none is. */
static int fallen(Instance *i) {
    double values[SOME(INDICATORS)];
    guards(i, values);
    for (int k = 0; k < INDICATORS && !i->context.failed; k++)
        if (values[k] < 0.0) return k;
    return -1;
}

/* The types differ in their first letters; an Enumeration is got and set as an Integer. */
INLINE int is_of(const Variable *v, const char *kind) {
    return *v->kind == *kind || (*v->kind == 'E' && *kind == 'I');
}

/* The variable of this reference; refuses what is unknown or of another type. */
INLINE const Variable *variable(Context *c, const char *kind, fmi2ValueReference reference) {
    if (reference >= VARIABLES)
        fail(c, "value reference %d is unknown", (double)reference);
    else if (!is_of(&variables[reference], kind))
        fail(c, "%s is of type %s, not %s", variables[reference].name, variables[reference].kind,
             kind);
    return c->failed ? NULL : &variables[reference];
}

INLINE int is_input(fmi2ValueReference reference) {
    return reference >= FIRST_INPUT && reference < FIRST_INPUT + INPUTS;
}

INLINE int is_integrated(fmi2ValueReference reference) {
    return reference >= FIRST_STATE && reference < FIRST_STATE + STATES &&
           *variables[reference].variability == 'c';
}

/* Whether a value may be read as it stands. */
INLINE int at_hand(const State *s, const char *kind, fmi2ValueReference reference) {
    return reference < FIRST_DERIVATIVE && is_of(&variables[reference], kind) &&
           (s->stale == 0.0 || (*kind == 'R' && s->phase == STEPPING &&
                                variables[reference].settable_before_start));
}

/* Refuse references that are not of this type; bring the outputs up to date. */
static int prepared(Instance *i, const char *kind, const fmi2ValueReference vr[], size_t n) {
    const int begun = i->state.phase != INITIALIZING; /* until then the state is to be settled */
    int held = !strcmp(kind, "Real"), derived = 0;
    for (size_t k = 0; k < n; k++) {
        if (!variable(&i->context, kind, vr[k])) return 0;
        held &= vr[k] < FIRST_STATE || (begun && variables[vr[k]].settable_before_start);
        derived |= vr[k] >= FIRST_DERIVATIVE;
    }
    if (!held && i->state.stale != 0.0 && i->state.phase != INSTANTIATED) refresh(i);
    if (derived && i->state.phase != INSTANTIATED && i->state.phase != FAILED)
        derive(i, part(i, FIRST_DERIVATIVE));
    return !i->context.failed;
}

/* Whether a value is one to set: most are inputs between steps. */
INLINE int expected(const State *s, const char *kind, fmi2ValueReference reference, double value) {
    return s->phase == STEPPING && is_input(reference) && is_of(&variables[reference], kind) &&
           is_finite(value);
}

static int may_set(Instance *i, const char *kind, fmi2ValueReference reference, double value) {
    Context *c = &i->context;
    const Variable *v = variable(c, kind, reference);
    int phase = (int)i->state.phase;
    if (!v) return 0;
    check_finite(c, v, value);
    if (c->failed) return 0;
    if (phase <= INITIALIZING ? v->settable_before_start
                              : phase <= INTEGRATING && is_input(reference))
        return 1;
    fail(c, "%s = %v cannot be set: %s %s, %s", v->name, v, value, v->variability, v->causality,
         PHASES[phase]);
    return 0;
}
