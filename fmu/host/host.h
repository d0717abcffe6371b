/* What plain C hosts share: an end with a message, a clock, and the rows of a table of numbers. */

#ifndef SIM_HEATING_HOST_H
#define SIM_HEATING_HOST_H

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { MOST = 256, LINE = 8192, MEAN = 50 };

static inline void stop(const char *what, const char *which) {
    fprintf(stderr, "host: %s%s\n", what, which);
    exit(1);
}

static inline double now(void) {
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Numbers of the next row, commas between them, MOST at most; how many there were, 0 behind the last row. */
static inline size_t read_line(FILE *file, double values[]) {
    char line[LINE], *at = line, *end;
    size_t count = 0;
    if (!fgets(line, sizeof line, file)) return 0;
    for (; count < MOST; at = end + 1) {
        values[count] = strtod(at, &end);
        if (end == at) break;
        count++;
        if (*end != ',') break;
    }
    return count;
}

#endif
