/* Preloaded into a process: of the datagrams it sends, a seeded share never leaves it.
 * LOSSY_SHARE: share to drop; LOSSY_SEED: of the choice; LOSSY_COUNTS: file of two uint64, sent and dropped. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

struct counts {
    _Atomic uint64_t sent, dropped;
};

static struct counts nowhere;
static struct counts *counts = &nowhere;
static uint64_t seed, threshold;

__attribute__((constructor)) static void begin(void)
{
    int file = open(getenv("LOSSY_COUNTS"), O_RDWR);
    void *memory = mmap(NULL, sizeof *counts, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (memory == MAP_FAILED)
        abort();
    close(file);
    counts = memory;
    seed = strtoull(getenv("LOSSY_SEED"), NULL, 10);
    threshold = (uint64_t)(atof(getenv("LOSSY_SHARE")) * 4294967296.0);
}

static int is_datagram(int socket)
{
    int type = 0, domain = 0;
    socklen_t size = sizeof type;
    getsockopt(socket, SOL_SOCKET, SO_TYPE, &type, &size);
    getsockopt(socket, SOL_SOCKET, SO_DOMAIN, &domain, &size);
    return type == SOCK_DGRAM && domain == AF_INET;
}

/* splitmix64 of the datagram's number */
static int lost(int socket)
{
    uint64_t x;
    if (!is_datagram(socket))
        return 0;
    x = seed + 0x9e3779b97f4a7c15u * (atomic_fetch_add(&counts->sent, 1) + 1);
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    if ((x ^ x >> 31) >> 32 >= threshold)
        return 0;
    atomic_fetch_add(&counts->dropped, 1);
    return 1;
}

static size_t length(const struct msghdr *message)
{
    size_t sum = 0;
    for (size_t i = 0; i < message->msg_iovlen; i++)
        sum += message->msg_iov[i].iov_len;
    return sum;
}

ssize_t send(int socket, const void *data, size_t size, int flags)
{
    ssize_t (*next)(int, const void *, size_t, int) = dlsym(RTLD_NEXT, "send");
    return lost(socket) ? (ssize_t)size : next(socket, data, size, flags);
}

ssize_t sendto(int socket, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t to_size)
{
    ssize_t (*next)(int, const void *, size_t, int, const struct sockaddr *, socklen_t) = dlsym(RTLD_NEXT, "sendto");
    return lost(socket) ? (ssize_t)size : next(socket, data, size, flags, to, to_size);
}

ssize_t sendmsg(int socket, const struct msghdr *message, int flags)
{
    ssize_t (*next)(int, const struct msghdr *, int) = dlsym(RTLD_NEXT, "sendmsg");
    return lost(socket) ? (ssize_t)length(message) : next(socket, message, flags);
}

/* One by one, so that each has its own fate. */
int sendmmsg(int socket, struct mmsghdr *messages, unsigned int count, int flags)
{
    unsigned int i;
    for (i = 0; i < count; i++) {
        ssize_t sent = sendmsg(socket, &messages[i].msg_hdr, flags);
        if (sent < 0)
            return i ? (int)i : -1;
        messages[i].msg_len = (unsigned int)sent;
    }
    return (int)i;
}
