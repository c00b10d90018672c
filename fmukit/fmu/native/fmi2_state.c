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

static int among(double value, double least, double most) {
    return value >= least && value <= most && value == floor(value);
}

/* Whether a variable can have this value. */
static int can_be(const Variable *v, double value) {
    const double least = *v->kind == 'B' || *v->kind == 'E' ? 0.0 : -v->most;
    return value >= least && value <= v->most && (*v->kind == 'R' || value == floor(value));
}

/* Whether an instance can have this state: who knows the checksum can write any bytes. */
static int possible(const State *s) {
    if (!among(s->phase, INSTANTIATED, FAILED) || !among(s->driven, 0.0, HIGHEST_DEGREE)) return 0;
    if (!among(s->kind, COSIMULATION, MODEL_EXCHANGE) || !among(s->events, 0.0, MOST_EVENTS)) return 0;
    if (kind_of((int)s->phase) != EITHER && kind_of((int)s->phase) != s->kind) return 0;
    if (!is_finite(s->time) || !is_finite(s->past) || !among(s->stale, 0.0, 1.0)) return 0;
    for (int k = 0; k < VARIABLES; k++)
        if (!can_be(&variables[k], s->values[k])) return 0;
    for (int k = 0; k < INPUTS; k++) {
        const Variable *v = &variables[FIRST_INPUT + k];
        if (!can_be(v, s->before[k]) || !can_be(v, s->end[k]) || !is_finite(s->slopes[k])) return 0;
        for (int order = 0; order < HIGHEST_DEGREE; order++)
            if (!is_finite(s->rates[order][k])) return 0;
    }
    return 1;
}

static Saved *saved(Instance *i, size_t more) {
    Saved *state = i->allocate(1, sizeof *state + more);
    if (!state) fail(&i->context, "no memory for an FMU state");
    return state;
}

EXPORT fmi2Status API(fmi2GetFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *i = component;
    Saved *kept;
    if (!i || !state) return fmi2Error;
    kept = *state ? *state : saved(i, 0);
    if (!kept) return finish(i);
    kept->sound = 1;
    kept->state = i->state;
    *state = kept;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SetFMUstate)(fmi2Component component, fmi2FMUstate state) {
    Instance *i = component;
    Saved *kept = state;
    if (!i) return fmi2Error;
    if (kept && kept->sound && kept->state.kind != i->kind)
        fail(&i->context, "FMU state is of an instance for %s, but this one is for %s",
             KINDS[(int)kept->state.kind], KINDS[i->kind]);
    else if (kept && kept->sound)
        i->state = kept->state;
    else
        fail(&i->context, "FMU state is damaged or not of this build " GUID ": %d bytes",
             kept ? (double)kept->size : 0.0);
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
    Saved *kept = state;
    if (!component || !kept) return fmi2Error;
    *size = kept->sound ? BYTES : kept->size;
    return fmi2OK;
}

EXPORT fmi2Status API(fmi2SerializeFMUstate)(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                      size_t size) {
    Instance *i = component;
    Saved *kept = state;
    unsigned char *at = (unsigned char *)bytes;
    if (!i || !kept) return fmi2Error;
    if (size < (kept->sound ? BYTES : kept->size)) {
        fail(&i->context, "%d bytes are too few for an FMU state", (double)size);
    } else if (kept->sound) {
        unsigned long sum;
        memcpy(at, GUID, sizeof GUID);
        memcpy(at + sizeof GUID, &kept->state, sizeof kept->state);
        sum = checksum(at, BYTES - 4);
        for (int k = 0; k < 4; k++) at[BYTES - 4 + k] = (unsigned char)(sum >> 8 * k);
    } else {
        memcpy(at, kept->bytes, kept->size);
    }
    return finish(i);
}

EXPORT fmi2Status API(fmi2DeSerializeFMUstate)(fmi2Component component, const fmi2Byte bytes[],
                                        size_t size, fmi2FMUstate *state) {
    Instance *i = component;
    const unsigned char *at = (const unsigned char *)bytes;
    Saved *kept;
    if (!i || !state) return fmi2Error;
    if (*state) i->release(*state), *state = NULL;
    if (!(kept = saved(i, size))) return finish(i);
    kept->sound = 0;
    kept->size = size;
    if (size) memcpy(kept->bytes, bytes, size);
    if (size == BYTES && !memcmp(at, GUID, sizeof GUID)) {
        unsigned long sum = checksum(at, BYTES - 4);
        kept->sound = 1;
        for (int k = 0; k < 4; k++)
            if (at[BYTES - 4 + k] != (unsigned char)(sum >> 8 * k)) kept->sound = 0;
        memcpy(&kept->state, at + sizeof GUID, sizeof kept->state);
        kept->sound = kept->sound && possible(&kept->state);
    }
    *state = kept;
    return fmi2OK;
}
