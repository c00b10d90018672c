/* A component for Windows that needs nothing but the C library of Windows, ucrtbase.dll: what
   MinGW's headers take for granted, and a stack that grows page by page. MODEL is the generated
   file. The mathematics are those that Python on Windows has, too, and no library of MinGW is built,
   which would take a minute of processor time. */

#include MODEL

#include <math.h>

int __isnan(double x) { return __builtin_isnan(x); }

int __fpclassify(double x) {
    return __builtin_fpclassify(FP_NAN, FP_INFINITE, FP_NORMAL, FP_SUBNORMAL, FP_ZERO, x);
}

/* Called with the size of a large frame in rax, which no register may feel: it touches every page. */
__asm__(".globl ___chkstk_ms\n"
        "___chkstk_ms:\n"
        "  push %rcx\n"
        "  push %rax\n"
        "  lea 24(%rsp), %rcx\n"
        "1: cmp $4096, %rax\n"
        "  jb 2f\n"
        "  sub $4096, %rcx\n"
        "  orb $0, (%rcx)\n"
        "  sub $4096, %rax\n"
        "  jmp 1b\n"
        "2: sub %rax, %rcx\n"
        "  orb $0, (%rcx)\n"
        "  pop %rax\n"
        "  pop %rcx\n"
        "  ret\n");
