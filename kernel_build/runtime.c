/* What the code that numba makes calls beside libc and libm, and the level of the processor. */
#if defined(__linux__)
#define _GNU_SOURCE
#endif
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#if defined(_WIN32)
#define EXPORTED
#define INTERNAL
#else
#define EXPORTED __attribute__((visibility("default")))
#define INTERNAL __attribute__((visibility("hidden")))
#endif

#include "array_files.c"

/* The memory of an array that is made inside a kernel; the layout is numba's. */
typedef struct {
    size_t references;
    void (*destructor)(void *, size_t, void *);
    void *destructor_info;
    void *data;
    size_t size;
    void *allocator;
} MemInfo;

INTERNAL MemInfo *NRT_MemInfo_alloc_aligned(size_t size, unsigned alignment)
{
    const size_t extra = sizeof(MemInfo) + alignment;
    MemInfo *info = size <= SIZE_MAX - extra ? array_malloc(size + extra) : NULL;
    if (!info)
        return NULL;
    uintptr_t data = (uintptr_t)(info + 1);
    data = (data + alignment - 1) / alignment * alignment;
    *info = (MemInfo){1, NULL, NULL, (void *)data, size, NULL};
    return info;
}

INTERNAL void NRT_MemInfo_call_dtor(MemInfo *info) { array_free(info); }

INTERNAL double numba_ldexp(double value, int power) { return ldexp(value, power); }

#if defined(__x86_64__)
#include <cpuid.h>

/* 3 where the processor has all of x86-64-v3 and the system saves the wide registers, else 2. */
EXPORTED int msal_cpu_level(void)
{
    unsigned a, b, c, d;
    const unsigned of_1 = bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C;
    if (__get_cpuid_max(0, NULL) < 7 || !__get_cpuid(1, &a, &b, &c, &d) || (c & of_1) != of_1)
        return 2;
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & 6) != 6)
        return 2;
    const unsigned of_7 = bit_AVX2 | bit_BMI | bit_BMI2;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & of_7) != of_7)
        return 2;
    return __get_cpuid(0x80000001, &a, &b, &c, &d) && (c & bit_LZCNT) ? 3 : 2;
}
#else
/* 0: there is one level only. */
EXPORTED int msal_cpu_level(void) { return 0; }
#endif

#ifdef HAS_V2
EXPORTED const char msal_has_v2 = 1;
#endif
#ifdef HAS_V3
EXPORTED const char msal_has_v3 = 1;
#endif
