/* Counts allocations during steps; linked with an FMU's wrapper and -Wl,--wrap for malloc, calloc and realloc:
   allocation RESOURCES TOKEN */

#include "fmi/fmi3Functions.h"

#include <stdio.h>

static long count;
void *__real_malloc(size_t size);
void *__real_calloc(size_t n, size_t size);
void *__real_realloc(void *old, size_t size);
void *__wrap_malloc(size_t size) { count++; return __real_malloc(size); }
void *__wrap_calloc(size_t n, size_t size) { count++; return __real_calloc(n, size); }
void *__wrap_realloc(void *old, size_t size) { count++; return __real_realloc(old, size); }

int main(int n, char *arguments[]) {
    if (n != 3) return 2;
    fmi3Instance fmu = fmi3InstantiateCoSimulation("counted", arguments[2], arguments[1], false, false, false, false, NULL, 0, NULL, NULL, NULL);
    const fmi3ValueReference inputs[] = {1, 2, 3, 4, 5, 6, 7, 8};
    double given[] = {7e4, 6500.0, 40.0, 0.0, 0.0, 10.0, 8e-5, 0.0}, last;
    bool event, stop, early, good = fmu && fmi3SetFloat64(fmu, inputs, 8, given, 8) == fmi3OK &&
                                    fmi3EnterInitializationMode(fmu, false, 0.0, 0.0, false, 0.0) == fmi3OK &&
                                    fmi3ExitInitializationMode(fmu) == fmi3OK;
    long before = count;
    for (int k = 0; good && k < 1000; k++) {
        given[2] = 40.0 + 0.01 * k;
        good = fmi3SetFloat64(fmu, inputs, 8, given, 8) == fmi3OK &&
               fmi3DoStep(fmu, 0.1 * k, 0.1, true, &event, &stop, &early, &last) == fmi3OK;
    }
    printf("before %ld\nduring %ld\n", before, count - before);
    if (fmu) fmi3FreeInstance(fmu);
    return good ? 0 : 1;
}
