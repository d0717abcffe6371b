/* Memory and time of many instances of an FMU of heating, linked with its wrapper:   instances RESOURCES TOKEN

   Writes bytes that an instance takes in addition to others, bytes of a serialised state, and the fastest means of MEAN
   calls [us]: a step of one instance, its state taken, its state restored with the step that follows it, less a step, and a
   step of each of several instances in turn. */

#include "fmi/fmi3Functions.h"
#include "host/host.h"

#include <malloc.h>

enum { FEW = 8, MANY = 40, ROUNDS = 40 };

static fmi3Instance instances[MANY];
static double times[MANY];
static const char *resources, *token;

static void need(bool good, const char *what) {
    if (!good) stop("refused: ", what);
}

static double in_use(void) {
    struct mallinfo2 info = mallinfo2();
    return (double)(info.uordblks + info.hblkhd);
}

static void step(int i) {
    static const fmi3ValueReference inputs[] = {1, 2, 3, 4, 5, 6, 7, 8};
    const double given[] = {7e4, 6500.0, 40.0 + 0.01 * i, 0.0, 0.0, 10.0, 8e-5, 0.0};
    double last = times[i];
    bool event, end, early;
    need(fmi3SetFloat64(instances[i], inputs, 8, given, 8) == fmi3OK, "inputs");
    need(fmi3DoStep(instances[i], times[i], 0.1, true, &event, &end, &early, &last) == fmi3OK, "step");
    times[i] = last;
}

static void start(int i) {
    instances[i] = fmi3InstantiateCoSimulation("counted", token, resources, false, false, false, false, NULL, 0, NULL, NULL, NULL);
    need(instances[i] != NULL, "instance");
    times[i] = 0.0;
    need(fmi3EnterInitializationMode(instances[i], false, 0.0, 0.0, false, 0.0) == fmi3OK, "initialization");
    need(fmi3ExitInitializationMode(instances[i]) == fmi3OK, "initialization");
    step(i);
}

int main(int n, char *arguments[]) {
    if (n != 3) stop("usage: instances RESOURCES TOKEN", "");
    resources = arguments[1], token = arguments[2];
    for (int i = 0; i < FEW; i++) start(i);
    double few = in_use();
    for (int i = FEW; i < MANY; i++) start(i);
    printf("instance_bytes %.0f\n", (in_use() - few) / (MANY - FEW));

    double best[5] = {1e9, 1e9, 1e9, 1e9, 1e9};
    fmi3FMUState state = NULL;
    size_t size = 0;
    for (int round = 0; round < ROUNDS; round++) {
        double spent[5] = {0}, time = times[0], at;
        for (int k = 0; k < MEAN; k++) at = now(), step(0), spent[0] += now() - at;
        need(fmi3GetFMUState(instances[0], &state) == fmi3OK, "state"), time = times[0];
        for (int k = 0; k < MEAN; k++) at = now(), need(fmi3GetFMUState(instances[0], &state) == fmi3OK, "state"), spent[1] += now() - at;
        for (int k = 0; k < MEAN; k++) {
            at = now(), need(fmi3SetFMUState(instances[0], state) == fmi3OK, "state");
            times[0] = time, step(0), spent[2] += now() - at;
        }
        for (int k = 0; k < MEAN; k++) at = now(), step(k % 2 ? 1 : 0), spent[3] += now() - at;
        for (int k = 0; k < MEAN; k++) at = now(), step(k % MANY), spent[4] += now() - at;
        for (int k = 0; k < 5; k++) best[k] = spent[k] < MEAN * best[k] ? spent[k] / MEAN : best[k];
    }
    need(fmi3SerializedFMUStateSize(instances[0], state, &size) == fmi3OK, "size");
    printf("state_bytes %zu\nstep_us %.3f\nget_us %.3f\nset_us %.3f\ntwo_us %.3f\nmany_us %.3f\n", size, 1e6 * best[0], 1e6 * best[1],
           1e6 * (best[2] - best[0]), 1e6 * best[3], 1e6 * best[4]);
    for (int i = 0; i < MANY; i++) fmi3FreeInstance(instances[i]);
    return 0;
}
