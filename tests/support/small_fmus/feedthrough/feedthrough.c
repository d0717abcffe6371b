/* Outputs that are inputs, and an input that may only be set in the states in which FMI allows it: the Feedthrough model
   of the Modelica Reference FMUs, for FMI 2 and FMI 3 co-simulation. */
#include <stdlib.h>
#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { INSTANTIATED, INITIALIZATION, STEPS, OVER };
enum { FIRST_OUTPUT = 4, LAST = 8 }; /* value references: inputs 0 to 3, outputs 4 to 7 */

typedef struct { double input[FIRST_OUTPUT]; int integer, state; } Feedthrough;

static Feedthrough *new_feedthrough(void) { return calloc(1, sizeof(Feedthrough)); }
#define F ((Feedthrough *)c)

static int get_real(void *c, const unsigned vr[], size_t n, double v[]) {
    if (F->state == INSTANTIATED || F->state == OVER) return 3;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= LAST) return 3;
        v[i] = F->input[vr[i] % FIRST_OUTPUT];
    }
    return 0;
}
static int set_real(void *c, const unsigned vr[], size_t n, const double v[]) {
    if (F->state == OVER) return 3;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= FIRST_OUTPUT) return 3;
        F->input[vr[i]] = v[i];
    }
    return 0;
}
static int go(void *c, int from, int to) {
    if (F->state != from) return 3;
    F->state = to;
    return 0;
}

/* ---- FMI 2 ---- */
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean on) { return new_feedthrough(); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real t, fmi2Real s, fmi2Boolean e, fmi2Real x) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return go(c, INSTANTIATED, INITIALIZATION); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return go(c, INITIALIZATION, STEPS); }
fmi2Status fmi2Terminate(fmi2Component c) { return go(c, STEPS, OVER); }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real v[]) { return get_real(c, vr, n, v); }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real v[]) { return set_real(c, vr, n, v); }
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) v[i] = F->integer;
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) F->integer = v[i];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real dt, fmi2Boolean n) { return F->state == STEPS ? fmi2OK : fmi2Error; }

/* ---- FMI 3 ---- */
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible, fmi3Boolean on, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference vr[], size_t n, fmi3InstanceEnvironment e, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) { return new_feedthrough(); }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 t, fmi3Float64 s, fmi3Boolean e, fmi3Float64 x) { return go(c, INSTANTIATED, INITIALIZATION); }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return go(c, INITIALIZATION, STEPS); }
fmi3Status fmi3Terminate(fmi3Instance c) { return go(c, STEPS, OVER); }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 v[], size_t m) { return get_real(c, vr, n, v); }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 v[], size_t m) { return set_real(c, vr, n, v); }
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 v[], size_t m) { return fmi2GetInteger(c, vr, n, v); }
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 v[], size_t m) { return fmi2SetInteger(c, vr, n, v); }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 dt, fmi3Boolean n, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    *event = *end = *early = 0, *last = t + dt;
    return F->state == STEPS ? fmi3OK : fmi3Error;
}
