/* Instances: what may be called when, and what follows from their state. */

static double *values_from(Instance *i, int first) { return i->state.values + first; }

static void reset_instance(Instance *i) {
    memset(&i->state, 0, sizeof i->state);
    memset(&i->context, 0, sizeof i->context);
    for (int k = 0; k < VARIABLES; k++) i->state.values[k] = variables[k].start;
    memcpy(i->state.before, values_from(i, FIRST_INPUT), INPUTS * sizeof(double));
    memcpy(i->state.end, values_from(i, FIRST_INPUT), INPUTS * sizeof(double));
    i->state.stale = 1.0;
    i->state.phase = INSTANTIATED;
    i->state.kind = i->kind;
}

/* Hosts take a message as a printf format. */
static void log_message(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name,
                 fmi2Status status, const char *category, const char *message) {
    char text[2 * TEXT_SIZE + 1], *at = text;
    if (!logger) return;
    for (; *message && at < text + sizeof text - 2; message++) {
        if (FORMATS && *message == '%') *at++ = '%';
        *at++ = *message;
    }
    *at = '\0';
    logger(environment, name, status, category, text);
}

/* Hand on the notes of a call, or its failure with the notes before it. */
static fmi2Status report_messages(Instance *i) {
    Context *c = &i->context;
    fmi2Status status = fmi2OK;
    char text[TEXT_SIZE];
    size_t length = 0;
    if (c->dropped) {
        append_value(c->notes, &c->notes_length, "Integer", (double)c->dropped);
        append_text(c->notes, &c->notes_length, " more messages are left out\n");
    }
    if (c->failed) {
        append_text(text, &length, i->name);
        append_text(text, &length, ": ");
        for (char *end, *line = c->notes; *line && length < TEXT_SIZE / 2; line = end + 1) {
            *(end = strchr(line, '\n')) = '\0';
            append_text(text, &length, i->name), append_text(text, &length, ": ");
            append_text(text, &length, line), append_text(text, &length, "; ");
        }
        append_text(text, &length, c->why ? c->why : c->reason);
    }
    if (c->failed && c->discarded) {
        status = fmi2Discard;
        if (i->logging)
            log_message(i->logger, i->environment, i->name, status, "logStatusWarning", text);
    } else if (c->failed) {
        for (int k = FIRST_STATE; k < VARIABLES; k++)
            if (!strcmp(variables[k].kind, "Real")) i->state.values[k] = NAN;
        i->state.stale = 0.0;
        i->state.phase = FAILED;
        status = fmi2Error;
        log_message(i->logger, i->environment, i->name, status, "logStatusError", text);
    } else {
        for (char *end, *line = c->notes; i->logging && *line; line = end + 1) {
            if (!(end = strchr(line, '\n'))) break;
            *end = '\0';
            length = 0;
            append_text(text, &length, i->name), append_text(text, &length, ": "), append_text(text, &length, line);
            log_message(i->logger, i->environment, i->name, fmi2Warning, "logStatusWarning", text);
        }
    }
    c->notes[c->notes_length = c->dropped = 0] = '\0';
    clear_context(c);
    return status;
}

/* End a call. */
INLINE fmi2Status finish(Instance *i) {
    return i->context.failed || i->context.notes_length ? report_messages(i) : fmi2OK;
}

/* The kind of instance that has this phase. */
static int kind_of(int phase) {
    if (phase == STEPPING) return COSIMULATION;
    return phase == INTEGRATING || (phase == AT_EVENT && !EVENTS_IN_STEPS) ? EXCHANGE : EITHER;
}

static void refuse_call(Instance *i, const char *call, int kind, int first, int last) {
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
    refuse_call(i, call, kind, first, last);
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
static const double *current_inputs(Instance *i) {
    const int stepping = i->kind == COSIMULATION && i->state.phase != AT_EVENT;
    return stepping ? i->state.end : values_from(i, FIRST_INPUT);
}

/* What an integrator tries may fail. */
static void mark_discardable(Instance *i) {
    i->context.discarded = i->context.failed && i->state.phase == INTEGRATING;
}

/* Check the parameters after some of them have changed in motion. */
static int check_changed_parameters(Instance *i) {
    if (i->state.unchecked != 0.0 && !i->context.failed) {
        model_check(&i->context, i->state.values);
        i->state.unchecked = 0.0;
    }
    return !i->context.failed;
}

/* Calculate the outputs from the state and the inputs of this instant. */
static void refresh(Instance *i) {
    Context *c = &i->context;
    State *s = &i->state;
    double *x = values_from(i, FIRST_STATE), result[ARRAY_LENGTH(STATES + OUTPUTS)];
    if (s->phase == INITIALIZING) {
        model_check_start(c, s->values);
        model_check(c, s->values);
        c->notes[c->notes_length = c->dropped = 0] = '\0';
        if (c->failed) return;
        memcpy(s->end, values_from(i, FIRST_INPUT), INPUTS * sizeof(double));
        model_initial(c, s->values, s->time, x, s->end, result);
        if (!c->failed) memcpy(x, result, STATES * sizeof *x);
    } else {
        if (!check_changed_parameters(i)) return;
        model_outputs(c, s->values, s->time, x, current_inputs(i), result + STATES);
    }
    for (int k = 0; k < OUTPUTS; k++) check_finite(c, &variables[FIRST_OUTPUT + k], result[STATES + k]);
    mark_discardable(i);
    if (c->failed) return;
    memcpy(values_from(i, FIRST_OUTPUT), result + STATES, OUTPUTS * sizeof *result);
    s->stale = 0.0;
}

/* Bring up to date what has been set during initialisation, and check what has been tuned. */
static int refresh_initial(Instance *i) {
    if (i->state.phase == INITIALIZING && i->state.stale != 0.0) refresh(i);
    return check_changed_parameters(i);
}

/* The derivatives of the continuous states at this instant. */
static void compute_derivatives(Instance *i, double *result) {
    Context *c = &i->context;
    State *s = &i->state;
    if (!refresh_initial(i)) return;
    model_derivatives(c, s->values, s->time, values_from(i, FIRST_STATE), current_inputs(i), result);
    for (int k = 0; k < DERIVATIVES; k++)
        check_finite(c, &variables[FIRST_DERIVATIVE + k], result[k]);
    mark_discardable(i);
}

/* The event indicators at this instant; an event is where one becomes negative. */
static void event_indicators(Instance *i, double *result) {
    State *s = &i->state;
    if (!refresh_initial(i)) return;
    model_event_indicators(&i->context, s->values, s->time, values_from(i, FIRST_STATE), current_inputs(i), result);
    for (int k = 0; k < INDICATORS; k++)
        if (!is_finite(result[k]))
            fail(&i->context, "event indicator %d = %r must be a finite number", k + 1.0, result[k]);
    mark_discardable(i);
}

/* The first event indicator that is negative, -1 if none is. */
static int first_negative_indicator(Instance *i) {
    double values[ARRAY_LENGTH(INDICATORS)];
    event_indicators(i, values);
    for (int k = 0; k < INDICATORS && !i->context.failed; k++)
        if (values[k] < 0.0) return k;
    return -1;
}

/* The types differ in their first letters; an Enumeration is got and set as an Integer. */
INLINE int has_type(const Variable *v, const char *kind) {
    return *v->kind == *kind || (*v->kind == 'E' && *kind == 'I');
}

/* The variable of this reference; refuses what is unknown or of another type. */
INLINE const Variable *variable(Context *c, const char *kind, fmi2ValueReference reference) {
    if (reference >= VARIABLES)
        fail(c, "value reference %d is unknown", (double)reference);
    else if (!has_type(&variables[reference], kind))
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

INLINE int is_tunable(fmi2ValueReference reference) {
    return *variables[reference].variability == 't';
}

/* Whether a value may be read as it stands. */
INLINE int is_up_to_date(const State *s, const char *kind, fmi2ValueReference reference) {
    return reference < FIRST_DERIVATIVE && has_type(&variables[reference], kind) &&
           (s->stale == 0.0 || (*kind == 'R' && s->phase == STEPPING &&
                                variables[reference].settable_before_start));
}

/* Refuse references that are not of this type; bring the outputs up to date. */
static int require_type_and_refresh(Instance *i, const char *kind, const fmi2ValueReference vr[], size_t n) {
    const int is_initialised = i->state.phase != INITIALIZING; /* until then the state is to be completed */
    int is_held = !strcmp(kind, "Real"), is_derived = 0;
    for (size_t k = 0; k < n; k++) {
        if (!variable(&i->context, kind, vr[k])) return 0;
        is_held &= vr[k] < FIRST_STATE || (is_initialised && variables[vr[k]].settable_before_start);
        is_derived |= vr[k] >= FIRST_DERIVATIVE;
    }
    if (!is_held && i->state.stale != 0.0 && i->state.phase != INSTANTIATED) refresh(i);
    if (is_derived && i->state.phase != INSTANTIATED && i->state.phase != FAILED)
        compute_derivatives(i, values_from(i, FIRST_DERIVATIVE));
    return !i->context.failed;
}

/* Whether a value is one to set: most are inputs between steps. */
INLINE int is_plain_input(const State *s, const char *kind, fmi2ValueReference reference, double value) {
    return s->phase == STEPPING && is_input(reference) && has_type(&variables[reference], kind) &&
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
    if ((phase == STEPPING || phase == AT_EVENT) && is_tunable(reference)) return 1;
    fail(c, "%s = %v cannot be set: %s %s, %s", v->name, v, value, v->variability, v->causality,
         PHASES[phase]);
    return 0;
}
