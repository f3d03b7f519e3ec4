/* Memory of large arrays (NEP 49 of numpy): kept for the next ones, or in files without a name, which
   the system pages in and out.  A part of runtime.c. */
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
#define LARGEST_PAGE (64 << 10)
#define MAX_KEPT 1024
#define MIN_KEPT (2 << 20)
#define HUGE_PAGE (2 << 20)
#define MAX_SPARE (24 << 20)

typedef struct {
    char *start;
    size_t size;
    int is_file;
} Block;

static Block blocks[MAX_BLOCKS];
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

/* Note a block; 0 where there is no place for it. */
static int add_block(char *start, size_t size, int is_file)
{
    int at = 0;
    while (at < block_count && blocks[at].start)
        at++;
    if (at == MAX_BLOCKS)
        return 0;
    blocks[at] = (Block){start, size, is_file};
    block_count = at < block_count ? block_count : at + 1;
    return 1;
}

static void *new_block(size_t size)
{
    char *start = map_file(size);
    if (!start)
        return NULL;
    lock();
    int is_noted = add_block(start, size, 1);
    unlock();
    if (!is_noted) {
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

/* Memory of arrays that have ended, for the next ones: the system clears what it gives, which may take
   as long as to compute.  With the arrays it is less than those alone have taken, by ``MAX_SPARE`` or
   an eighth, since other memory may be needed later. */
static Block kept[MAX_KEPT];
static int kept_count;
static atomic_int is_kept;
static size_t array_bytes, kept_bytes, most_bytes;

static size_t round_up(size_t size) { return (size + LARGEST_PAGE - 1) / LARGEST_PAGE * LARGEST_PAGE; }

static Block pop_kept(int at)
{
    Block block = kept[at];
    kept[at] = kept[--kept_count];
    kept_bytes -= block.size;
    return block;
}

/* Give memory back until there are so many bytes with the arrays. */
static void trim(size_t bytes)
{
    while (kept_count && array_bytes + kept_bytes > bytes) {
        size_t excess = round_up(array_bytes + kept_bytes - bytes);
        if (excess > kept[0].size)
            excess = kept[0].size;
        kept[0].size -= excess;
        kept_bytes -= excess;
        munmap(kept[0].start + kept[0].size, excess);
        if (!kept[0].size)
            pop_kept(0);
    }
}

static size_t bound(void)
{
    size_t spare = most_bytes / 8;
    return most_bytes - (spare < MAX_SPARE ? spare : MAX_SPARE);
}

static void keep(Block block)
{
    if (!is_kept || block.size < MIN_KEPT || kept_count == MAX_KEPT) {
        munmap(block.start, block.size);
        return;
    }
    kept[kept_count++] = block;
    kept_bytes += block.size;
}

/* Pages behind those of a block, which move, and lie in huge pages as before. */
static char *extend(Block block, size_t size)
{
    char *start = mmap(NULL, size + HUGE_PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (start == MAP_FAILED) {
        if (block.size)
            munmap(block.start, block.size);
        return NULL;
    }
    size_t before = ((uintptr_t)block.start - (uintptr_t)start) % HUGE_PAGE;
    if (before)
        munmap(start, before);
    start += before;
    munmap(start + size, HUGE_PAGE - before);
    if (block.size)
        start = mremap(block.start, block.size, size, MREMAP_MAYMOVE | MREMAP_FIXED, start);
    if (start == MAP_FAILED)
        return NULL;
    madvise(start, size, MADV_HUGEPAGE);
    return start;
}

/* Memory for an array: of the smallest block that is large enough, or of the largest and new pages;
   ``used`` bytes of it are not zero. */
static char *take(size_t size, size_t *used)
{
    int best = 0;
    for (int at = 1; at < kept_count; at++)
        if (kept[best].size < size ? kept[at].size > kept[best].size
                                   : kept[at].size >= size && kept[at].size < kept[best].size)
            best = at;
    Block block = kept_count ? pop_kept(best) : (Block){NULL, 0, 0};
    array_bytes += size;
    most_bytes = array_bytes > most_bytes ? array_bytes : most_bytes;
    if (block.size > size)
        keep((Block){block.start + size, block.size - size, 0});
    trim(bound());
    *used = block.size < size ? block.size : size;
    char *start = block.size < size ? extend(block, size) : block.start;
    if (!start) {
        trim(0);
        *used = 0;
        start = extend((Block){NULL, 0, 0}, size);
    }
    if (start && add_block(start, size, 0))
        return start;
    array_bytes -= size;
    return NULL;
}

/* A block; NULL for what malloc has given. */
static Block *find_block(void *start)
{
    for (int at = 0; at < block_count; at++)
        if (blocks[at].start == start)
            return &blocks[at];
    return NULL;
}

static int is_large(size_t size)
{
    size_t bound = smallest;
    return bound && size >= bound;
}

static void *allocate(size_t size, int is_zero)
{
    if (is_large(size))
        return new_block(size);
    if (!is_kept || size < MIN_KEPT || size > SIZE_MAX / 2)
        return is_zero ? calloc(1, size) : malloc(size);
    size_t used;
    lock();
    char *start = take(round_up(size), &used);
    unlock();
    return start && is_zero ? memset(start, 0, used) : start;
}

INTERNAL void *array_malloc(size_t size) { return allocate(size, 0); }

INTERNAL void array_free(void *start)
{
    Block block = {NULL, 0, 0};
    if (start && !((uintptr_t)start % SMALLEST_PAGE)) {
        lock();
        Block *found = find_block(start);
        if (found) {
            block = *found;
            found->start = NULL;
            if (!block.is_file) {
                array_bytes -= block.size;
                keep(block);
            }
        }
        unlock();
    }
    if (!block.start)
        free(start);
    else if (block.is_file) {
        munmap(start, block.size);
        atomic_fetch_sub(&current_bytes, block.size);
    }
}

static void *numpy_malloc(void *context, size_t size) { return array_malloc(size); }

static void *numpy_calloc(void *context, size_t count, size_t item)
{
    if (item && count > SIZE_MAX / item)
        return NULL;
    return allocate(count * item, 1);
}

static void *numpy_realloc(void *context, void *start, size_t size)
{
    lock();
    Block *block = start ? find_block(start) : NULL;
    size_t old = block ? block->size : 0, whole = round_up(size);
    int is_cut = block && !block->is_file && size && whole <= old;
    if (is_cut && whole < old) {
        /* What an array does not need after all has not been written to. */
        munmap(block->start + whole, old - whole);
        block->size = whole;
        array_bytes -= old - whole;
        most_bytes = most_bytes > array_bytes + old - whole ? most_bytes - (old - whole) : array_bytes;
    }
    unlock();
    if (is_cut)
        return start;
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

/* Keep the memory of arrays from now on, or give back what is kept. */
EXPORTED void msal_keep_memory(int yes)
{
    lock();
    is_kept = yes;
    most_bytes = yes ? array_bytes : 0;
    trim(most_bytes);
    unlock();
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
