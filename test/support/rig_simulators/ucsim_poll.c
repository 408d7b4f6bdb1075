/* Preloaded into s51: a stopped simulator sleeps 100 ms before it looks at its console, ten exchanges a
 * second. Sleeping on the console instead gives thousands. */
#include <poll.h>
#include <time.h>

int nanosleep(const struct timespec *request, struct timespec *left)
{
    struct pollfd console = {0, POLLIN, 0};
    (void)left;
    poll(&console, 1, (int)(request->tv_sec * 1000 + request->tv_nsec / 1000000));
    return 0;
}
