/* The functions of FMI 2.0 for co-simulation. Those of model exchange exist and refuse. */

#include "fmi/fmi2Functions.h"
#include "wrapper.h"

#include <stdlib.h>
#include <string.h>

#define REFUSED(c, name) return (fmi2Status)refuse(c, name, "is not offered by this FMU")

/* The message is the format itself, for hosts that print it as it is. */
static void report(Instance *m, Status status, const char *category, const char *message) {
    fmi2CallbackLogger logger = (fmi2CallbackLogger)m->log;
    char format[2048], *at = format;
    for (; *message && at < format + sizeof format - 2; message++) {
        if (*message == '%') *at++ = '%';
        *at++ = *message;
    }
    *at = 0;
    if (logger && (m->logging || status == ERROR)) logger(m->environment, m->name, (fmi2Status)status, category, format);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)n, (void)categories;
    if (!allowed(c, "fmi2SetDebugLogging", ANY)) return fmi2Error;
    ((Instance *)c)->logging = on != fmi2False;
    return fmi2OK;
}

static int hex(char c) { return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1; }

/* file:///path, file:/path or file://localhost/path as a path; a path stays one. */
static bool path_of_uri(const char *uri, char *path, size_t size) {
    if (!uri) return false;
    bool file = false;
    if (strncmp(uri, "file:", 5) == 0) {
        uri += 5;
        if (strncmp(uri, "//localhost/", 12) == 0) uri += 11;
        else if (strncmp(uri, "///", 3) == 0) uri += 2;
        file = true;
    }
    size_t at = 0;
    for (; *uri; uri++) {
        if (at + 1 >= size) return false;
        if (uri[0] == '%' && hex(uri[1]) >= 0 && hex(uri[2]) >= 0) {
            path[at++] = (char)(16 * hex(uri[1]) + hex(uri[2]));
            uri += 2;
        } else {
            path[at++] = *uri;
        }
    }
    path[at] = 0;
    if (file && at > 2 && path[0] == '/' && path[2] == ':') memmove(path, path + 1, at);  /* /C:/... */
    return true;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)visible;
    char path[4096];
    if (!functions) return NULL;
    if (type != fmi2CoSimulation) {
        if (functions->logger)
            functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", "this FMU supports co-simulation only");
        return NULL;
    }
    bool found = path_of_uri(location, path, sizeof path);
    Instance *m = new_instance(name, guid, found ? path : NULL, functions->componentEnvironment, (void *)functions->logger, report);
    if (m) m->logging = logging != fmi2False;
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free_instance(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance;
    if (!allowed(c, "fmi2SetupExperiment", INSTANTIATED)) return fmi2Error;
    return (fmi2Status)set_experiment(c, start, stop_defined != fmi2False, stop);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (fmi2Status)enter_initialization(c); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (fmi2Status)exit_initialization(c); }
fmi2Status fmi2Reset(fmi2Component c) { return (fmi2Status)reset(c); }

fmi2Status fmi2Terminate(fmi2Component c) {
    if (!allowed(c, "fmi2Terminate", STEPPING | FAILED)) return fmi2Error;
    ((Instance *)c)->mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    return (fmi2Status)get_numbers(c, vr, n, value, n);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    return (fmi2Status)set_numbers(c, vr, n, value, n);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    if (!allowed(c, "fmi2GetInteger", ANY)) return fmi2Error;
    if (n > 0 && (!vr || !value)) return (fmi2Status)refuse(c, "fmi2GetInteger", "no array is given");
    for (size_t k = 0; k < n; k++) {
        int64_t number;
        if (get_integer(c, vr[k], &number) != OK) return fmi2Error;
        value[k] = (fmi2Integer)number;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    if (!allowed(c, "fmi2SetInteger", SETTABLE)) return fmi2Error;
    if (n > 0 && (!vr || !value)) return (fmi2Status)refuse(c, "fmi2SetInteger", "no array is given");
    for (size_t k = 0; k < n; k++)
        if (set_integer(c, vr[k], value[k]) != OK) return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    (void)vr, (void)value;
    if (!allowed(c, "fmi2GetBoolean", ANY)) return fmi2Error;
    return n == 0 ? fmi2OK : (fmi2Status)refuse(c, "fmi2GetBoolean", "there is no Boolean variable");
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    (void)vr, (void)value;
    if (!allowed(c, "fmi2SetBoolean", SETTABLE)) return fmi2Error;
    return n == 0 ? fmi2OK : (fmi2Status)refuse(c, "fmi2SetBoolean", "there is no Boolean variable");
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    if (!allowed(c, "fmi2GetString", ANY)) return fmi2Error;
    if (n > 0 && (!vr || !value)) return (fmi2Status)refuse(c, "fmi2GetString", "no array is given");
    for (size_t k = 0; k < n; k++)
        if (get_text(c, vr[k], &value[k]) != OK) return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    if (!allowed(c, "fmi2SetString", SETTABLE)) return fmi2Error;
    if (n > 0 && (!vr || !value)) return (fmi2Status)refuse(c, "fmi2SetString", "no array is given");
    for (size_t k = 0; k < n; k++)
        if (set_text(c, vr[k], value[k]) != OK) return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return (fmi2Status)get_state(c, state); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return (fmi2Status)set_state(c, state); }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { return (fmi2Status)free_state(c, state); }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) { return (fmi2Status)state_size(c, state, size); }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) { return (fmi2Status)serialize(c, state, bytes, size); }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) { return (fmi2Status)deserialize(c, bytes, size, state); }

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
    if (!allowed(c, "fmi2SetRealInputDerivatives", INITIALIZATION | STEPPING)) return fmi2Error;
    if (n > 0 && (!vr || !order || !value)) return (fmi2Status)refuse(c, "fmi2SetRealInputDerivatives", "no array is given");
    for (size_t k = 0; k < n; k++) {
        if (order[k] != 1) return (fmi2Status)refuse(c, "fmi2SetRealInputDerivatives", "inputs are linear in a step; give order 1");
        if (set_slope(c, vr[k], value[k]) != OK) return fmi2Error;
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)n, (void)order, (void)value;
    REFUSED(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real length, fmi2Boolean no_return) {
    (void)no_return;
    if (!hold(c, "do step", STEPPING)) return fmi2Error;
    return (fmi2Status)release(c, prepare_step(c, time, length) == OK ? finish_step(c) : ERROR);
}

fmi2Status fmi2CancelStep(fmi2Component c) { REFUSED(c, "fmi2CancelStep"); }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    if (!allowed(c, "fmi2GetStatus", STEPPING | TERMINATED | FAILED) || !value) return fmi2Error;
    if (kind != fmi2DoStepStatus) return (fmi2Status)refuse(c, "fmi2GetStatus", "there is no status of this kind");
    *value = ((Instance *)c)->mode == FAILED ? fmi2Error : fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (!value || !hold(c, "fmi2GetRealStatus", STEPPING | TERMINATED | FAILED)) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return (fmi2Status)release(c, refuse(c, "fmi2GetRealStatus", "there is no number of this kind"));
    *value = ((Instance *)c)->R[NOW];
    return (fmi2Status)release(c, OK);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!allowed(c, "fmi2GetBooleanStatus", STEPPING | TERMINATED | FAILED) || !value) return fmi2Error;
    if (kind != fmi2Terminated) return (fmi2Status)refuse(c, "fmi2GetBooleanStatus", "there is no Boolean of this kind");
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    REFUSED(c, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    REFUSED(c, "fmi2GetStringStatus");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[], fmi2Real result[]) {
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)result;
    REFUSED(c, "fmi2GetDirectionalDerivative");
}

/* Model exchange */
fmi2Status fmi2EnterEventMode(fmi2Component c) { REFUSED(c, "fmi2EnterEventMode"); }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) { (void)info; REFUSED(c, "fmi2NewDiscreteStates"); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { REFUSED(c, "fmi2EnterContinuousTimeMode"); }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_return, fmi2Boolean *event, fmi2Boolean *terminate) {
    (void)no_return, (void)event, (void)terminate;
    REFUSED(c, "fmi2CompletedIntegratorStep");
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { (void)time; REFUSED(c, "fmi2SetTime"); }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi2SetContinuousStates"); }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi2GetDerivatives"); }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi2GetEventIndicators"); }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi2GetContinuousStates"); }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { (void)x, (void)n; REFUSED(c, "fmi2GetNominalsOfContinuousStates"); }
