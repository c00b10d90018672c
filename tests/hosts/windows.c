/* MODEL, a program of this folder, for Windows as the FMUs are: without a C library of its own. */

#include "../../fmukit/fmu/native/windows.c"

int vfprintf(FILE *file, const char *form, va_list values) {
    return __stdio_common_vfprintf(0, file, form, NULL, values);
}

int fprintf(FILE *file, const char *form, ...) {
    va_list values;
    int length;
    va_start(values, form);
    length = vfprintf(file, form, values);
    va_end(values);
    return length;
}

int printf(const char *form, ...) {
    va_list values;
    int length;
    va_start(values, form);
    length = vfprintf(stdout, form, values);
    va_end(values);
    return length;
}

void __main(void) {}

int _configure_narrow_argv(int mode);

void mainCRTStartup(void) {
    _configure_narrow_argv(1); /* as they are given, no wildcards */
    exit(main(*__p___argc(), *__p___argv()));
}
