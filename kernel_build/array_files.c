/* Large arrays in files without a name, which the system pages in and out (NEP 49 of numpy).
   A part of runtime.c. */
#if defined(__linux__)
#include <errno.h>
#include <fcntl.h>
#include <malloc.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/utsname.h>
#include <unistd.h>

#define MAX_BLOCKS 16384
#define SMALLEST_PAGE 4096

static struct Block {
    char *start;
    size_t size;
} blocks[MAX_BLOCKS];
static int block_count;
static atomic_flag is_locked = ATOMIC_FLAG_INIT;

/* The folder, and the bytes from which on an array lives there; 0 while none does. */
static int folder = -1;
static _Atomic size_t smallest;
static _Atomic size_t current_bytes, peak_bytes;
static atomic_int last_error;

/* No mutex: glibc 2.17 has them in a library of their own. */
static void lock(void)
{
    while (atomic_flag_test_and_set_explicit(&is_locked, memory_order_acquire))
        sched_yield();
}

static void unlock(void) { atomic_flag_clear_explicit(&is_locked, memory_order_release); }

/* A file that no process can find by name: one that never had a name, or lost it at once. */
static int open_nameless(void)
{
    static atomic_uint counter;
    const int flags = O_RDWR | O_CLOEXEC;
    int file = -1;
#ifdef O_TMPFILE
    file = openat(folder, ".", flags | O_TMPFILE | O_EXCL, 0600);
#endif
    for (int tries = 0; file < 0 && tries < 100; tries++) {
        char name[64];
        unsigned number = atomic_fetch_add(&counter, 1);
        snprintf(name, sizeof name, ".msal-%ld-%u.tmp", (long)getpid(), number);
        file = openat(folder, name, flags | O_CREAT | O_EXCL | O_NOFOLLOW, 0600);
        if (file >= 0)
            unlinkat(folder, name, 0);
        else if (errno != EEXIST)
            break;
    }
    return file;
}

/* Have the system read ahead 2 MB, in pages of that size where it can: its usual windows, of up to 8 MB,
   push one another out where many arrays are read at once.  Linux before 6 would read single pages. */
static void advise(char *start, size_t size)
{
    struct utsname system;
    int is_known = !madvise(start, size, MADV_HUGEPAGE);
    if (is_known && !uname(&system) && atoi(system.release) >= 6)
        madvise(start, size, MADV_RANDOM);
}

/* Space is taken before the file is mapped: written to where the disk is full, a mapping is SIGBUS. */
static char *map_file(size_t size)
{
    int file = open_nameless();
    if (file < 0) {
        last_error = errno;
        return NULL;
    }
    int error = posix_fallocate(file, 0, (off_t)size);
    char *start = MAP_FAILED;
    if (!error) {
        start = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
        error = errno;
    }
    close(file);
    if (start != MAP_FAILED) {
        advise(start, size);
        return start;
    }
    last_error = error;
    return NULL;
}

static void *new_block(size_t size)
{
    char *start = map_file(size);
    if (!start)
        return NULL;
    lock();
    int at = 0;
    while (at < block_count && blocks[at].start)
        at++;
    if (at < MAX_BLOCKS) {
        blocks[at] = (struct Block){start, size};
        block_count = at < block_count ? block_count : at + 1;
    }
    unlock();
    if (at == MAX_BLOCKS) {
        last_error = ENFILE;
        munmap(start, size);
        return NULL;
    }
    size_t now = atomic_fetch_add(&current_bytes, size) + size;
    size_t peak = peak_bytes;
    while (now > peak && !atomic_compare_exchange_weak(&peak_bytes, &peak, now))
        ;
    return start;
}

/* The size of a block; 0 for what malloc has given.  With ``is_taken`` it is forgotten. */
static size_t find_block(void *start, int is_taken)
{
    if (!start || (uintptr_t)start % SMALLEST_PAGE)
        return 0;
    size_t size = 0;
    lock();
    for (int at = 0; at < block_count && !size; at++)
        if (blocks[at].start == start) {
            size = blocks[at].size;
            if (is_taken)
                blocks[at].start = NULL;
        }
    unlock();
    return size;
}

static int is_large(size_t size)
{
    size_t bound = smallest;
    return bound && size >= bound;
}

INTERNAL void *array_malloc(size_t size) { return is_large(size) ? new_block(size) : malloc(size); }

INTERNAL void array_free(void *start)
{
    size_t size = find_block(start, 1);
    if (!size) {
        free(start);
        return;
    }
    munmap(start, size);
    atomic_fetch_sub(&current_bytes, size);
}

static void *numpy_malloc(void *context, size_t size) { return array_malloc(size); }

static void *numpy_calloc(void *context, size_t count, size_t item)
{
    if (item && count > SIZE_MAX / item)
        return NULL;
    return is_large(count * item) ? new_block(count * item) : calloc(count, item);
}

static void *numpy_realloc(void *context, void *start, size_t size)
{
    size_t old = find_block(start, 0);
    if (!old && !is_large(size))
        return realloc(start, size);
    if (!old)
        old = malloc_usable_size(start);
    char *next = array_malloc(size);
    if (!next)
        return NULL;
    memcpy(next, start, old < size ? old : size);
    array_free(start);
    return next;
}

static void numpy_free(void *context, void *start, size_t size) { array_free(start); }

/* numpy's PyDataMem_Handler, version 1. */
EXPORTED struct {
    char name[127];
    uint8_t version;
    void *context;
    void *(*malloc)(void *, size_t);
    void *(*calloc)(void *, size_t, size_t);
    void *(*realloc)(void *, void *, size_t);
    void (*free)(void *, void *, size_t);
} msal_array_handler = {
    "msal_array_files", 1, NULL, numpy_malloc, numpy_calloc, numpy_realloc, numpy_free,
};

/* Have new arrays of so many bytes and more live in an open folder, which is closed here; 0: none. */
EXPORTED void msal_use_array_files(int opened, size_t bytes)
{
    smallest = 0;
    if (folder >= 0)
        close(folder);
    folder = opened;
    if (bytes) {
        peak_bytes = current_bytes;
        last_error = 0;
    }
    smallest = bytes;
}

/* Bytes in files now, at the peak since they are used, and why the last one was refused. */
EXPORTED void msal_count_array_files(size_t *now, size_t *peak, int *error)
{
    *now = current_bytes;
    *peak = peak_bytes;
    *error = last_error;
}
#else
INTERNAL void *array_malloc(size_t size) { return malloc(size); }
INTERNAL void array_free(void *start) { free(start); }
#endif
