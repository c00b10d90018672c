/* A component for WebAssembly: a flat interface of numbers over fmi2.c, which needs no imports.

   MODEL is the generated file. Variables are numbers that `find` knows by the name in `text`; a
   status is that of FMI. What the instance has to say since it was last asked stands in `text`.

   No C library is linked, since to compile one takes far longer than the component: what fmi2.c needs
   of texts and memory is here, and the mathematics come from the sources of Zig's C library. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define NO_BUILTIN __attribute__((no_builtin)) /* or a compiler makes of a loop a call of itself */
enum { ALIGNMENT = 16, PAGE = 65536 };

NO_BUILTIN size_t strlen(const char *text) {
    const char *end = text;
    while (*end) end++;
    return (size_t)(end - text);
}

NO_BUILTIN int strcmp(const char *a, const char *b) {
    while (*a && *a == *b) a++, b++;
    return (unsigned char)*a - (unsigned char)*b;
}

NO_BUILTIN char *strcpy(char *target, const char *source) {
    for (char *at = target; (*at++ = *source++);) {}
    return target;
}

NO_BUILTIN char *strchr(const char *text, int character) {
    while (*text && *text != (char)character) text++;
    return *text == (char)character ? (char *)text : NULL;
}

/* Memory comes in blocks of few sizes, those of instances and of their states, so that a free block
   waits for another of its size. */
typedef struct Block {
    size_t size;
    struct Block *next;
} Block;

extern unsigned char __heap_base;
static Block *free_blocks;
static uintptr_t heap_end;

NO_BUILTIN void *calloc(size_t count, size_t size) {
    const size_t content = (count * size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    Block **link = &free_blocks, *block;
    while (*link && (*link)->size != content) link = &(*link)->next;
    if ((block = *link)) {
        *link = block->next;
    } else {
        uintptr_t begin, memory = __builtin_wasm_memory_size(0) * PAGE;
        if (!heap_end) heap_end = ((uintptr_t)&__heap_base + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
        begin = heap_end;
        heap_end += ALIGNMENT + content;
        if (heap_end > memory &&
            __builtin_wasm_memory_grow(0, (heap_end - memory + PAGE - 1) / PAGE) == (size_t)-1) {
            heap_end = begin;
            return NULL;
        }
        block = (Block *)begin;
        block->size = content;
    }
    return memset((char *)block + ALIGNMENT, 0, content);
}

NO_BUILTIN void free(void *content) {
    Block *block = (Block *)((char *)content - ALIGNMENT);
    if (!content) return;
    block->next = free_blocks;
    free_blocks = block;
}

#define FMI2_FUNCTION_PREFIX flat_
#include MODEL

#define FLAT(name) __attribute__((export_name(#name)))

static char message_buffer[2 * TEXT_SIZE];

/* A message is a printf format, in which each % stands twice. */
static void collect_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                            fmi2String category, fmi2String form, ...) {
    size_t length = strlen(message_buffer);
    (void)environment, (void)name, (void)status, (void)category;
    if (length > sizeof message_buffer - TEXT_SIZE) return;
    if (length) message_buffer[length++] = '\n';
    for (; *form && length < sizeof message_buffer - 1; form++) {
        if (*form == '%' && form[1]) form++;
        message_buffer[length++] = *form;
    }
    message_buffer[length] = '\0';
}

static const fmi2CallbackFunctions callbacks = {collect_message, calloc, free, NULL, NULL};

/* Modules that are linked with a C library begin with this; here there is nothing to initialise. */
FLAT(_initialize) void flat_initialize(void) {}

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
    const fmi2Integer integer = (fmi2Integer)value;
    if (has_type(&variables[k], "Real")) return flat_fmi2SetReal(i, &k, 1, &value);
    if (has_type(&variables[k], "Boolean")) return flat_fmi2SetBoolean(i, &k, 1, &integer);
    return flat_fmi2SetInteger(i, &k, 1, &integer);
}

FLAT(get) double flat_get(fmi2Component i, fmi2ValueReference k) {
    double value = NAN;
    fmi2Integer integer;
    if (has_type(&variables[k], "Real")) return flat_fmi2GetReal(i, &k, 1, &value), value;
    if (has_type(&variables[k], "Boolean") ? flat_fmi2GetBoolean(i, &k, 1, &integer)
                                        : flat_fmi2GetInteger(i, &k, 1, &integer))
        return NAN;
    return integer;
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

FLAT(free) fmi2Status flat_free(fmi2Component i, fmi2FMUstate state) {
    return flat_fmi2FreeFMUstate(i, &state);
}
