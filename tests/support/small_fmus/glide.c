/* A vehicle that sinks and is braked, in closed form, as an FMI 2 and FMI 3 co-simulation and model-exchange FMU:

       dh/dt = -sink, 10 s later -2 sink (a time event)      dv/dt = -drag v^2

   and everything that an FMU can do wrong, at `fault_time`, chosen by `fault`. */
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { H, SPEED, ALPHA, COMMAND, SINK, DRAG, FAULT_TIME, HEIGHT0, SPEED0, FAULT, NUMBER, DER_H, DER_SPEED };
enum { NONE, FAILS, DISCARDS, RETURNS_EARLY, GIVES_NAN, CRASHES, HANGS, ENDS, EXITS, CHATTERS_AND_FAILS,
       FORKS_AND_CRASHES, FORKS_AND_HANGS, STARTS_A_PROCESS_AND_FAILS, LOGS_AND_FAILS, ENDS_FAR_AHEAD, ENDS_AT_NO_TIME,
       RETURNS_AT_THE_END };

#define EVENT_TIME 10.0
#define OUTPUT_KM 1000.0
#define OUTPUT_FT 0.3048
#define LOG "the \033[31mwing\007 came\xff off"

typedef struct {
    double value[FAULT], time;
    int fault, late, ended;
    fmi2CallbackLogger log2;
    fmi3LogMessageCallback log3;
} Glide;

static Glide *new_glide(void) {
#ifdef CRASH_AT_INSTANTIATE
    *(volatile int *)0 = 1;
#endif
#ifdef NO_INSTANCE
    return NULL;
#endif
    Glide *g = calloc(1, sizeof(Glide));
    g->value[SINK] = 50.0, g->value[DRAG] = 1e-6, g->value[FAULT_TIME] = 5.0;
    g->value[HEIGHT0] = 70e3, g->value[SPEED0] = 7000.0, g->value[COMMAND] = 0.7;
    return g;
}

static void start(Glide *g) { g->value[H] = g->value[HEIGHT0], g->value[SPEED] = g->value[SPEED0]; }
static double sink(const Glide *g) { return g->value[SINK] * (g->late ? 2.0 : 1.0); }

/* The closed form over a step within which nothing switches. */
static void glide(Glide *g, double dt) {
    g->value[H] -= sink(g) * dt;
    g->value[SPEED] /= 1.0 + g->value[DRAG] * g->value[SPEED] * dt;
    g->time += dt;
}

static int is_due(const Glide *g, double end) { return g->fault != NONE && end > g->value[FAULT_TIME]; }

static void break_down(Glide *g) {
    if (g->fault == CRASHES) raise(11);
    if (g->fault == HANGS) for (;;) sleep(1);
    if (g->fault == EXITS) exit(7);
    if ((g->fault == FORKS_AND_CRASHES || g->fault == FORKS_AND_HANGS) && fork() == 0) { sleep(30); _exit(0); }
    if (g->fault == FORKS_AND_CRASHES) raise(11);
    if (g->fault == FORKS_AND_HANGS) for (;;) sleep(1);
    if (g->fault == STARTS_A_PROCESS_AND_FAILS && system("sleep 30.25 >/dev/null 2>&1 &")) abort();
    if (g->fault == LOGS_AND_FAILS && g->log2) g->log2(NULL, "", fmi2Error, "error", "%s", LOG);
    if (g->fault == LOGS_AND_FAILS && g->log3) g->log3(NULL, fmi3Error, "error", LOG);
    if (g->fault == CHATTERS_AND_FAILS) { printf("the wing came off\n"); fflush(stdout); }
}

static int fails(const Glide *g) {
    return g->fault == FAILS || g->fault == CHATTERS_AND_FAILS || g->fault == STARTS_A_PROCESS_AND_FAILS ||
           g->fault == LOGS_AND_FAILS;
}

static int ends(const Glide *g) { return g->fault == ENDS || g->fault == ENDS_FAR_AHEAD || g->fault == ENDS_AT_NO_TIME; }

static double said_to_be_at(const Glide *g, double time) {
    return g->fault == ENDS_FAR_AHEAD ? 1e7 : g->fault == ENDS_AT_NO_TIME ? NAN : time;
}

static void move(Glide *g, double dt) {
    if (!g->late && g->time + dt >= EVENT_TIME) {
        double before = EVENT_TIME - g->time;
        glide(g, before);
        g->late = 1;
        dt -= before;
    }
    glide(g, dt);
}

static double get(const Glide *g, unsigned vr) {
    if (g->fault == GIVES_NAN && vr == SPEED && is_due(g, g->time)) return NAN;
    if (vr == H) return g->value[H] / OUTPUT_KM;
    if (vr == SPEED) return g->value[SPEED] / OUTPUT_FT;
    if (vr == ALPHA) return g->value[COMMAND];
    if (vr == DER_H) return -sink(g);
    if (vr == DER_SPEED) return -g->value[DRAG] * g->value[SPEED] * g->value[SPEED];
    if (vr == FAULT) return g->fault;
    if (vr == NUMBER) return 3.0;
    return g->value[vr];
}

/* ---- FMI 2 ---- */
#define G ((Glide *)c)
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean on) {
    Glide *g = new_glide();
    if (g) g->log2 = f->logger;
    return g;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real t, fmi2Real s, fmi2Boolean e, fmi2Real x) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { start(c); return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) v[i] = get(c, vr[i]);
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) G->value[vr[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) v[i] = (int)get(c, vr[i]);
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) G->fault = v[i];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real dt, fmi2Boolean n) {
    if (is_due(G, t + dt)) {
        break_down(c);
        if (fails(c)) return fmi2Error;
        if (G->fault == DISCARDS || G->fault == RETURNS_EARLY) return fmi2Discard;
        if (ends(c)) { move(c, dt); G->ended = 1; return fmi2Discard; }
    }
    move(c, dt);
    return fmi2OK;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) {
    *v = said_to_be_at(c, G->time);
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) { *v = G->ended; return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e) {
    memset(e, 0, sizeof(*e));
    if (G->time >= EVENT_TIME - 1e-9) G->late = 1;
    e->nextEventTimeDefined = !G->late, e->nextEventTime = EVENT_TIME;
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean n, fmi2Boolean *event, fmi2Boolean *end) {
    *event = 0, *end = G->fault == ENDS && is_due(G, G->time);
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { G->time = t; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    G->value[H] = x[0], G->value[SPEED] = x[1];
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = G->value[H], x[1] = G->value[SPEED];
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) {
    d[0] = get(c, DER_H), d[1] = get(c, DER_SPEED);
    return is_due(c, G->time) && G->fault == FAILS ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = 1e4, x[1] = 1e3;
    return fmi2OK;
}

/* ---- FMI 3 ---- */
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible, fmi3Boolean on, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference vr[], size_t n, fmi3InstanceEnvironment e, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
    Glide *g = new_glide();
    if (g) g->log3 = log;
    return g;
}
fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible, fmi3Boolean on,
    fmi3InstanceEnvironment e, fmi3LogMessageCallback log) { return new_glide(); }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 t, fmi3Float64 s, fmi3Boolean e, fmi3Float64 x) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { start(c); return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = get(c, vr[i]);
    return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 v[], size_t m) {
    for (size_t i = 0; i < n; i++) G->value[vr[i]] = v[i];
    return fmi3OK;
}
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = (int)get(c, vr[i]);
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 v[], size_t m) {
    for (size_t i = 0; i < n; i++) G->fault = v[i];
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 dt, fmi3Boolean n, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    *event = *end = *early = 0, *last = t + dt;
    if (is_due(G, t + dt)) {
        break_down(c);
        if (fails(c)) return fmi3Error;
        if (G->fault == DISCARDS) return fmi3Discard;
        if (G->fault == RETURNS_EARLY) { move(c, dt / 2); *early = 1, *last = t + dt / 2; return fmi3OK; }
        if (G->fault == RETURNS_AT_THE_END) *early = 1;
        if (ends(c)) *end = 1, *last = said_to_be_at(c, t + dt);
    }
    move(c, dt);
    return fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *changed, fmi3Boolean *defined, fmi3Float64 *next) {
    fmi2EventInfo e;
    fmi2NewDiscreteStates(c, &e);
    *again = *end = *nominals = *changed = 0, *defined = e.nextEventTimeDefined, *next = e.nextEventTime;
    return fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean n, fmi3Boolean *event, fmi3Boolean *end) {
    *event = 0, *end = G->fault == ENDS && is_due(G, G->time);
    return fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { G->time = t; return fmi3OK; }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2SetContinuousStates(c, x, n); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2GetContinuousStates(c, x, n); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 d[], size_t n) { return (fmi3Status)fmi2GetDerivatives(c, d, n); }
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) { return fmi3OK; }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2GetNominalsOfContinuousStates(c, x, n); }
