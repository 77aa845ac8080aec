// Simulates a hung disk for a program that is started with this library in LD_PRELOAD. While the file CRUMPLE_HANG exists,
// calls with a path that ends in .mcap do not return.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static void hang(const char* path) {
  const size_t length = strlen(path);
  const char* mark = getenv("CRUMPLE_HANG");
  if (!mark || length < 5 || strcmp(path + length - 5, ".mcap") != 0) return;
  const struct timespec pause = {0, 1000 * 1000};
  while (access(mark, F_OK) == 0) nanosleep(&pause, NULL);
}

static void hang_at(int file) {
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t size = readlink(link, path, sizeof path - 1);
  if (size <= 0) return;
  path[size] = 0;
  hang(path);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define OPEN(name)                                            \
  int name(const char* path, int flags, ...) {                \
    va_list rest;                                             \
    va_start(rest, flags);                                    \
    const int mode = flags & O_CREAT ? va_arg(rest, int) : 0; \
    va_end(rest);                                             \
    hang(path);                                               \
    return NEXT(name)(path, flags, mode);                     \
  }
OPEN(open)
OPEN(open64)

ssize_t write(int file, const void* data, size_t size) {
  hang_at(file);
  return NEXT(write)(file, data, size);
}

int fdatasync(int file) {
  hang_at(file);
  return NEXT(fdatasync)(file);
}
