/* The functions of FMI 3.0 for co-simulation. Those of the other interface types exist and refuse. */

#include "fmi/fmi3Functions.h"
#include "wrapper.h"

#include <string.h>

#define REFUSED(c, name) return (fmi3Status)refuse(c, name, "is not offered by this FMU")

static void report(Instance *m, Status status, const char *category, const char *message) {
    fmi3LogMessageCallback log = (fmi3LogMessageCallback)m->log;
    if (log && (m->logging || status == ERROR)) log(m->environment, (fmi3Status)status, category, message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)n, (void)categories;
    if (!allowed(c, "fmi3SetDebugLogging", ANY)) return fmi3Error;
    ((Instance *)c)->logging = on;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n_required, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)visible, (void)early_return, (void)required, (void)n_required;
    if (event_mode) {
        if (log) log(environment, fmi3Error, "logStatusError", "this FMU has no event mode; instantiate it with eventModeUsed = false");
        return NULL;
    }
    Instance *m = new_instance(name, token, resources, environment, (void *)log, report);
    if (m) m->logging = logging, m->update = (void *)update;
    return m;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (log) log(environment, fmi3Error, "logStatusError", "this FMU supports co-simulation only");
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    (void)clock, (void)lock, (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}

void fmi3FreeInstance(fmi3Instance c) { free_instance(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance;
    if (!allowed(c, "fmi3EnterInitializationMode", INSTANTIATED)) return fmi3Error;
    return set_experiment(c, start, stop_defined, stop) == OK ? (fmi3Status)enter_initialization(c) : fmi3Error;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (fmi3Status)exit_initialization(c); }
fmi3Status fmi3Reset(fmi3Instance c) { return (fmi3Status)reset(c); }

fmi3Status fmi3Terminate(fmi3Instance c) {
    if (!allowed(c, "fmi3Terminate", STEPPING | FAILED)) return fmi3Error;
    ((Instance *)c)->mode = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t n_values) {
    return (fmi3Status)get_numbers(c, vr, n, values, n_values);
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t n_values) {
    return (fmi3Status)set_numbers(c, vr, n, values, n_values);
}

fmi3Status fmi3GetInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int64 values[], size_t n_values) {
    if (!allowed(c, "fmi3GetInt64", ANY)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3GetInt64", "no array of that length is given");
    for (size_t k = 0; k < n; k++)
        if (get_integer(c, vr[k], &values[k]) != OK) return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int64 values[], size_t n_values) {
    if (!allowed(c, "fmi3SetInt64", SETTABLE)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3SetInt64", "no array of that length is given");
    for (size_t k = 0; k < n; k++)
        if (set_integer(c, vr[k], values[k]) != OK) return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 values[], size_t n_values) {
    if (!allowed(c, "fmi3GetInt32", ANY)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3GetInt32", "no array of that length is given");
    for (size_t k = 0; k < n; k++) {
        int64_t value;
        if (get_integer(c, vr[k], &value) != OK) return fmi3Error;
        values[k] = (fmi3Int32)value;
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 values[], size_t n_values) {
    if (!allowed(c, "fmi3SetInt32", SETTABLE)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3SetInt32", "no array of that length is given");
    for (size_t k = 0; k < n; k++)
        if (set_integer(c, vr[k], values[k]) != OK) return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String values[], size_t n_values) {
    if (!allowed(c, "fmi3GetString", ANY)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3GetString", "no array of that length is given");
    for (size_t k = 0; k < n; k++)
        if (get_text(c, vr[k], &values[k]) != OK) return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String values[], size_t n_values) {
    if (!allowed(c, "fmi3SetString", SETTABLE)) return fmi3Error;
    if (n != n_values || (n > 0 && (!vr || !values))) return (fmi3Status)refuse(c, "fmi3SetString", "no array of that length is given");
    for (size_t k = 0; k < n; k++)
        if (set_text(c, vr[k], values[k]) != OK) return fmi3Error;
    return fmi3OK;
}

/* Types that no variable has */
#define NO_VARIABLES(Type)                                                                                                      \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##Type values[], size_t n_values) {    \
        (void)vr, (void)values, (void)n_values;                                                                                 \
        if (!allowed(c, "fmi3Get" #Type, ANY)) return fmi3Error;                                                                \
        return n == 0 ? fmi3OK : (fmi3Status)refuse(c, "fmi3Get" #Type, "there is no variable of this type");                   \
    }                                                                                                                           \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##Type values[], size_t n_values) { \
        (void)vr, (void)values, (void)n_values;                                                                                 \
        if (!allowed(c, "fmi3Set" #Type, SETTABLE)) return fmi3Error;                                                           \
        return n == 0 ? fmi3OK : (fmi3Status)refuse(c, "fmi3Set" #Type, "there is no variable of this type");                   \
    }
NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[], size_t n_values) {
    (void)vr, (void)sizes, (void)values, (void)n_values;
    if (!allowed(c, "fmi3GetBinary", ANY)) return fmi3Error;
    return n == 0 ? fmi3OK : (fmi3Status)refuse(c, "fmi3GetBinary", "there is no variable of this type");
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary values[], size_t n_values) {
    (void)vr, (void)sizes, (void)values, (void)n_values;
    if (!allowed(c, "fmi3SetBinary", SETTABLE)) return fmi3Error;
    return n == 0 ? fmi3OK : (fmi3Status)refuse(c, "fmi3SetBinary", "there is no variable of this type");
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]) {
    (void)vr, (void)n, (void)values;
    REFUSED(c, "fmi3GetClock");
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[]) {
    (void)vr, (void)n, (void)values;
    REFUSED(c, "fmi3SetClock");
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return (fmi3Status)get_state(c, state); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return (fmi3Status)set_state(c, state); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) { return (fmi3Status)free_state(c, state); }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) { return (fmi3Status)state_size(c, state, size); }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) { return (fmi3Status)serialize(c, state, bytes, size); }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) { return (fmi3Status)deserialize(c, bytes, size, state); }

/* The host may set inputs at the end of the step: the step is linear to them. */
static void ask_for_inputs(Instance *m) {
    fmi3IntermediateUpdateCallback update = (fmi3IntermediateUpdateCallback)m->update;
    if (!update || timing(m) != HELD) return;
    fmi3Boolean early = fmi3False;
    fmi3Float64 early_time = m->R[NEXT];
    m->mode = INTERMEDIATE;
    update(m->environment, m->R[NEXT], fmi3True, fmi3False, fmi3False, fmi3False, &early, &early_time);
    if (m->mode != INTERMEDIATE) return;
    m->mode = STEPPING;
    memcpy(m->R + m->N[INPUTS_NEXT], m->R + m->N[INPUTS], (size_t)m->N[N_INPUTS] * sizeof(double));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 length, fmi3Boolean no_return, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_return;
    if (event) *event = fmi3False;
    if (terminate) *terminate = fmi3False;
    if (early) *early = fmi3False;
    if (!hold(c, "do step", STEPPING)) return fmi3Error;
    Instance *m = c;
    Status status = prepare_step(m, time, length);
    if (last && status == OK) *last = m->R[NOW];
    if (status == OK) ask_for_inputs(m);
    status = status == OK && m->mode == STEPPING ? finish_step(m) : ERROR;
    if (last && status == OK) *last = m->R[NOW];
    return (fmi3Status)release(m, status);
}

/* What this FMU has none of */
fmi3Status fmi3EnterEventMode(fmi3Instance c) { REFUSED(c, "fmi3EnterEventMode"); }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { REFUSED(c, "fmi3EnterStepMode"); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { REFUSED(c, "fmi3EnterConfigurationMode"); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { REFUSED(c, "fmi3ExitConfigurationMode"); }
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { REFUSED(c, "fmi3EvaluateDiscreteStates"); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { REFUSED(c, "fmi3EnterContinuousTimeMode"); }

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
    (void)vr, (void)n;
    REFUSED(c, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t elements[], fmi3ValueReference independents[],
                                       size_t of_independents[], fmi3DependencyKind kinds[], size_t n) {
    (void)vr, (void)elements, (void)independents, (void)of_independents, (void)kinds, (void)n;
    REFUSED(c, "fmi3GetVariableDependencies");
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                        const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                        fmi3Float64 result[], size_t n_result) {
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)result, (void)n_result;
    REFUSED(c, "fmi3GetDirectionalDerivative");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                    fmi3Float64 result[], size_t n_result) {
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)result, (void)n_result;
    REFUSED(c, "fmi3GetAdjointDerivative");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 x[], fmi3IntervalQualifier q[]) {
    (void)vr, (void)n, (void)x, (void)q;
    REFUSED(c, "fmi3GetIntervalDecimal");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 x[], fmi3UInt64 y[], fmi3IntervalQualifier q[]) {
    (void)vr, (void)n, (void)x, (void)y, (void)q;
    REFUSED(c, "fmi3GetIntervalFraction");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 x[]) {
    (void)vr, (void)n, (void)x;
    REFUSED(c, "fmi3GetShiftDecimal");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 x[], fmi3UInt64 y[]) {
    (void)vr, (void)n, (void)x, (void)y;
    REFUSED(c, "fmi3GetShiftFraction");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 x[]) {
    (void)vr, (void)n, (void)x;
    REFUSED(c, "fmi3SetIntervalDecimal");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 x[], const fmi3UInt64 y[]) {
    (void)vr, (void)n, (void)x, (void)y;
    REFUSED(c, "fmi3SetIntervalFraction");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 x[]) {
    (void)vr, (void)n, (void)x;
    REFUSED(c, "fmi3SetShiftDecimal");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 x[], const fmi3UInt64 y[]) {
    (void)vr, (void)n, (void)x, (void)y;
    REFUSED(c, "fmi3SetShiftFraction");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *update, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *time) {
    (void)update, (void)terminate, (void)nominals, (void)values, (void)defined, (void)time;
    REFUSED(c, "fmi3UpdateDiscreteStates");
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate) {
    (void)no_return, (void)event, (void)terminate;
    REFUSED(c, "fmi3CompletedIntegratorStep");
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { (void)time; REFUSED(c, "fmi3SetTime"); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi3SetContinuousStates"); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi3GetContinuousStateDerivatives"); }
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi3GetEventIndicators"); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi3GetContinuousStates"); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi3GetNominalsOfContinuousStates"); }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { (void)n; REFUSED(c, "fmi3GetNumberOfEventIndicators"); }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { (void)n; REFUSED(c, "fmi3GetNumberOfContinuousStates"); }

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values) {
    (void)vr, (void)n, (void)orders, (void)values, (void)n_values;
    REFUSED(c, "fmi3GetOutputDerivatives");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
    (void)clock, (void)time;
    REFUSED(c, "fmi3ActivateModelPartition");
}
