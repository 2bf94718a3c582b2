/* Disk and clock of a server under test, disturbed on demand: preloaded into the process, before the C library.
 *
 * The file named by FAULTS_ORDERS is mapped and read at each call, so that the test gives orders by writing to it.
 * Only regular files are disturbed, never sockets and pipes. Reading is never disturbed.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { DISK_WORKS, DISK_FULL, DISK_SLOW, DISK_HUNG };

/* As written by `disk.rs`. */
struct orders {
    volatile int64_t disk;
    volatile int64_t delay_us;
    volatile int64_t clock_offset_ns;
};

static struct orders none;
static struct orders *orders = &none;

__attribute__((constructor)) static void map_orders(void) {
    const char *path = getenv("FAULTS_ORDERS");
    int fd = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDONLY | O_CLOEXEC, 0) : -1;
    if (fd < 0) return;
    void *mapped = mmap(NULL, sizeof(struct orders), PROT_READ, MAP_SHARED, fd, 0);
    if (mapped != MAP_FAILED) orders = mapped;
    syscall(SYS_close, fd);
}

static void wait_for_disk(void) {
    if (orders->disk == DISK_SLOW) usleep((useconds_t)orders->delay_us);
    while (orders->disk == DISK_HUNG) usleep(2000);
}

static int is_file(int fd) {
    struct stat status;
    int error = errno, found = fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
    errno = error;
    return found;
}

/* Waits as long as the disk takes; -1 if nothing can be written. */
static int before_write(int fd) {
    if (orders->disk == DISK_WORKS || !is_file(fd)) return 0;
    wait_for_disk();
    if (orders->disk != DISK_FULL) return 0;
    errno = ENOSPC;
    return -1;
}

ssize_t write(int fd, const void *bytes, size_t count) {
    return before_write(fd) ? -1 : syscall(SYS_write, fd, bytes, count);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    return before_write(fd) ? -1 : syscall(SYS_writev, fd, parts, count);
}

ssize_t pwrite64(int fd, const void *bytes, size_t count, off64_t offset) {
    return before_write(fd) ? -1 : syscall(SYS_pwrite64, fd, bytes, count, offset);
}

ssize_t pwrite(int fd, const void *bytes, size_t count, off_t offset) {
    return pwrite64(fd, bytes, count, offset);
}

int fsync(int fd) {
    wait_for_disk();
    return (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd) {
    wait_for_disk();
    return (int)syscall(SYS_fdatasync, fd);
}

int rename(const char *from, const char *to) {
    wait_for_disk();
    return (int)syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
}

static int open_file(int folder, const char *path, int flags, mode_t mode) {
    if (flags & (O_WRONLY | O_RDWR | O_CREAT)) wait_for_disk();
    return (int)syscall(SYS_openat, folder, path, flags, mode);
}

#define MODE(flags, last)                                                  \
    mode_t mode = 0;                                                       \
    if ((flags) & (O_CREAT | O_TMPFILE)) {                                 \
        va_list rest;                                                      \
        va_start(rest, last);                                              \
        mode = va_arg(rest, mode_t);                                       \
        va_end(rest);                                                      \
    }

int open(const char *path, int flags, ...) {
    MODE(flags, flags)
    return open_file(AT_FDCWD, path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    MODE(flags, flags)
    return open_file(AT_FDCWD, path, flags, mode);
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    int result = (int)syscall(SYS_clock_gettime, clock, time);
    if (result == 0 && clock == CLOCK_REALTIME && orders->clock_offset_ns != 0) {
        int64_t ns = time->tv_sec * 1000000000LL + time->tv_nsec + orders->clock_offset_ns;
        time->tv_sec = ns / 1000000000LL;
        time->tv_nsec = ns % 1000000000LL;
    }
    return result;
}
