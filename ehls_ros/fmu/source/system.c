/* What differs between the systems. A library for Windows brings its own entry point and probe of large stack frames, and has the
   messages formatted by ucrtbase.dll of the system: without a C runtime, the first link takes a second, not minutes. */
#ifdef _WIN32

#include <stdarg.h>
#include <stddef.h>

int __stdcall DllMainCRTStartup(void *module, unsigned long reason, void *reserved) { return 1; }

/* The compiler expects this symbol wherever floating point is used. */
int _fltused = 0;

/* Touch every page of a frame of rax bytes; keep all registers. */
__attribute__((naked)) void ___chkstk_ms(void) {
    __asm__("push %rcx\n push %rax\n cmp $0x1000, %rax\n lea 24(%rsp), %rcx\n jb 2f\n"
            "1: sub $0x1000, %rcx\n test %rcx, (%rcx)\n sub $0x1000, %rax\n cmp $0x1000, %rax\n ja 1b\n"
            "2: sub %rax, %rcx\n test %rcx, (%rcx)\n pop %rax\n pop %rcx\n ret\n");
}

__attribute__((dllimport)) int __stdio_common_vsprintf(unsigned long long options, char *text, size_t size,
                                                       const char *format, void *locale, va_list arguments);

int format_text(char *text, size_t size, const char *format, va_list arguments) {
    return __stdio_common_vsprintf(2, text, size, format, NULL, arguments); /* 2: as snprintf of C99 */
}

#else

#include <stdarg.h>
#include <stdio.h>

int format_text(char *text, size_t size, const char *format, va_list arguments) {
    return vsnprintf(text, size, format, arguments);
}

#endif
