/* The state of an instance; as bytes: the guid, the state and a checksum. */

enum { BYTES = sizeof GUID + sizeof(State) + 4 };

static unsigned long checksum(const unsigned char *bytes, size_t n) {
    unsigned long sum = 0xFFFFFFFFul;
    while (n--) {
        sum ^= *bytes++;
        for (int bit = 0; bit < 8; bit++) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320ul : 0);
    }
    return sum ^ 0xFFFFFFFFul;
}

static int is_integer_between(double value, double least, double most) {
    return value >= least && value <= most && value == floor(value);
}

/* Whether a variable can have this value. */
static int is_possible_value(const Variable *v, double value) {
    return value >= v->least && value <= v->most && (*v->kind == 'R' || value == floor(value));
}

/* Whether an instance can have this state: who knows the checksum can write any bytes. */
static int is_possible_state(const State *s) {
    if (!is_integer_between(s->phase, INSTANTIATED, FAILED) || !is_integer_between(s->driven, 0.0, HIGHEST_DEGREE)) return 0;
    if (!is_integer_between(s->kind, COSIMULATION, MODEL_EXCHANGE) || !is_integer_between(s->events, 0.0, MOST_EVENTS)) return 0;
    if (kind_of((int)s->phase) != EITHER && kind_of((int)s->phase) != s->kind) return 0;
    if (!is_finite(s->time) || !is_finite(s->past) || !is_integer_between(s->stale, 0.0, 1.0)) return 0;
    if (!is_integer_between(s->unchecked, 0.0, 1.0)) return 0;
    for (int k = 0; k < VARIABLES; k++)
        if (!is_possible_value(&variables[k], s->values[k])) return 0;
    for (int k = 0; k < INPUTS; k++) {
        const Variable *v = &variables[FIRST_INPUT + k];
        if (!is_possible_value(v, s->before[k]) || !is_possible_value(v, s->end[k]) || !is_finite(s->slopes[k])) return 0;
        for (int order = 0; order < HIGHEST_DEGREE; order++)
            if (!is_finite(s->rates[order][k])) return 0;
    }
    return 1;
}

static Saved *allocate_state(Instance *i, size_t more) {
    Saved *state = i->allocate(1, sizeof *state + more);
    if (!state) fail(&i->context, "no memory for an FMU state");
    return state;
}

EXPORT fmi2Status API(fmi2GetFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *i = component;
    Saved *saved_state;
    if (!i || !state) return fmi2Error;
    saved_state = *state ? *state : allocate_state(i, 0);
    if (!saved_state) return finish(i);
    saved_state->sound = 1;
    saved_state->state = i->state;
    *state = saved_state;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SetFMUstate)(fmi2Component component, fmi2FMUstate state) {
    Instance *i = component;
    Saved *saved_state = state;
    if (!i) return fmi2Error;
    if (saved_state && saved_state->sound && saved_state->state.kind != i->kind)
        fail(&i->context, "FMU state is of an instance for %s, but this one is for %s",
             KINDS[(int)saved_state->state.kind], KINDS[i->kind]);
    else if (saved_state && saved_state->sound)
        i->state = saved_state->state;
    else
        fail(&i->context, "FMU state is damaged or not of this build " GUID ": %d bytes",
             saved_state ? (double)saved_state->size : 0.0);
    return finish(i);
}

EXPORT fmi2Status API(fmi2FreeFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *i = component;
    if (!i) return fmi2Error;
    if (state && *state) i->release(*state), *state = NULL;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SerializedFMUstateSize)(fmi2Component component, fmi2FMUstate state,
                                           size_t *size) {
    Saved *saved_state = state;
    if (!component || !saved_state) return fmi2Error;
    *size = saved_state->sound ? BYTES : saved_state->size;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SerializeFMUstate)(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                      size_t size) {
    Instance *i = component;
    Saved *saved_state = state;
    unsigned char *at = (unsigned char *)bytes;
    if (!i || !saved_state) return fmi2Error;
    if (size < (saved_state->sound ? BYTES : saved_state->size)) {
        fail(&i->context, "%d bytes are too few for an FMU state", (double)size);
    } else if (saved_state->sound) {
        unsigned long sum;
        memcpy(at, GUID, sizeof GUID);
        memcpy(at + sizeof GUID, &saved_state->state, sizeof saved_state->state);
        sum = checksum(at, BYTES - 4);
        for (int k = 0; k < 4; k++) at[BYTES - 4 + k] = (unsigned char)(sum >> 8 * k);
    } else {
        memcpy(at, saved_state->bytes, saved_state->size);
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2DeSerializeFMUstate)(fmi2Component component, const fmi2Byte bytes[],
                                        size_t size, fmi2FMUstate *state) {
    Instance *i = component;
    const unsigned char *at = (const unsigned char *)bytes;
    Saved *saved_state;
    if (!i || !state) return fmi2Error;
    if (*state) i->release(*state), *state = NULL;
    if (!(saved_state = allocate_state(i, size))) return finish(i);
    saved_state->sound = 0;
    saved_state->size = size;
    if (size) memcpy(saved_state->bytes, bytes, size);
    if (size == BYTES && !memcmp(at, GUID, sizeof GUID)) {
        unsigned long sum = checksum(at, BYTES - 4);
        saved_state->sound = 1;
        for (int k = 0; k < 4; k++)
            if (at[BYTES - 4 + k] != (unsigned char)(sum >> 8 * k)) saved_state->sound = 0;
        memcpy(&saved_state->state, at + sizeof GUID, sizeof saved_state->state);
        saved_state->sound = saved_state->sound && is_possible_state(&saved_state->state);
    }
    *state = saved_state;
    return fmi2OK;
}
