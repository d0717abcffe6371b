/* Random legal and illegal calls of an FMU's functions, FMI 2 and FMI 3, linked with the wrapper itself so that
   sanitizers see it:   fuzz RESOURCES TOKEN VARIABLES SEED CALLS

   No call may crash, leak or hang, and none may answer with a status that there is not. Ends with how many calls were made,
   how many were refused and how many steps of a model ended well. Never called: functions of an instance that has been freed,
   which the standard forbids and nobody can detect. */

#include "fmi/fmi2Functions.h"
#include "fmi/fmi3Functions.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { INSTANCES = 3, STATES = 4, REFS = 6, VALUES = 8 };

typedef struct { void *instance, *states[STATES]; int version; double time; } Slot;

static uint64_t seed;
static unsigned n_variables;
static const char *resources, *token;
static long refused, stepped;
static Slot *asking;

static uint64_t draw(void) {
    seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
    return seed;
}

static int one_of(int n) { return (int)(draw() % (uint64_t)n); }

static double any_number(void) {
    static const double odd[] = {0.0, -0.0, 1.0, -1.0, 1e-300, 1e300, DBL_MAX, -DBL_MAX, DBL_MIN, 4.9e-324, 1e5, 7000.0, 40.0, 600.0, 1e-4};
    switch (one_of(12)) {
    case 0: return NAN;
    case 1: return one_of(2) ? INFINITY : -INFINITY;
    case 2: return odd[one_of((int)(sizeof odd / sizeof *odd))];
    case 3: return (double)(int64_t)draw();
    default: return ((double)(draw() >> 11) / 9007199254740992.0 - 0.3) * pow(10.0, one_of(7) - 2);
    }
}

static unsigned any_ref(void) { return one_of(8) ? (unsigned)one_of((int)n_variables) : (unsigned)draw(); }
static size_t any_count(void) { return (size_t)one_of(REFS + 1); }

static void took(int status) {
    if (status < 0 || status > 4) printf("an unknown status: %d\n", status), exit(3);
    refused += status != 0;
}

static void quiet2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String c, fmi2String m, ...) { (void)e, (void)name, (void)s, (void)c, (void)m; }
static void quiet3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m) { (void)e, (void)s, (void)c, (void)m; }

static void update(fmi3InstanceEnvironment e, fmi3Float64 t, fmi3Boolean set, fmi3Boolean get, fmi3Boolean done, fmi3Boolean may,
                   fmi3Boolean *early, fmi3Float64 *when) {
    (void)e, (void)t, (void)get, (void)done, (void)may, (void)early, (void)when;
    fmi3ValueReference ref = (fmi3ValueReference)(1 + one_of(8));
    double value = one_of(4) ? 1.0 : any_number();
    if (set && asking && one_of(3) == 0) took(fmi3SetFloat64(asking->instance, &ref, 1, &value, 1));
    if (asking && one_of(50) == 0) took(fmi3Reset(asking->instance));
}

static void instantiate(Slot *s) {
    static const fmi2CallbackFunctions functions = {quiet2, calloc, free, NULL, NULL};
    const char *where = one_of(20) ? resources : one_of(2) ? "/nowhere" : NULL, *which = one_of(20) ? token : one_of(2) ? "{}" : NULL;
    const char *name = one_of(20) ? "fuzz" : one_of(2) ? "" : NULL;
    s->version = 2 + one_of(2), s->time = 0.0;
    s->instance = s->version == 2 ? fmi2Instantiate(name, one_of(20) ? fmi2CoSimulation : fmi2ModelExchange, which, where, one_of(20) ? &functions : NULL, 0, one_of(2))
                                  : fmi3InstantiateCoSimulation(name, which, where, false, one_of(2), false, false, NULL, 0, NULL, one_of(2) ? quiet3 : NULL, one_of(2) ? update : NULL);
}

static void drop(Slot *s) {
    for (int k = 0; k < STATES; k++)
        if (s->states[k]) took(s->version == 2 ? (int)fmi2FreeFMUstate(s->instance, &s->states[k]) : (int)fmi3FreeFMUState(s->instance, &s->states[k]));
    if (s->version == 2) fmi2FreeInstance(s->instance); else fmi3FreeInstance(s->instance);
    s->instance = NULL;
}

static void values(Slot *s, bool two) {
    unsigned refs[REFS];
    double numbers[VALUES];
    fmi3Int64 integers[VALUES];
    int small[REFS], orders[REFS];
    const char *texts[REFS];
    size_t n = any_count(), m = one_of(4) ? n : (size_t)one_of(VALUES + 1);
    for (int k = 0; k < REFS; k++) {
        refs[k] = any_ref(), numbers[k] = any_number(), integers[k] = one_of(4), small[k] = one_of(4), orders[k] = one_of(3);
        texts[k] = one_of(3) == 0 ? NULL : one_of(2) ? "" : "/nowhere/table.csv";
    }
    numbers[6] = numbers[7] = 0.0, integers[6] = integers[7] = 0;
    unsigned *r = one_of(30) ? refs : NULL;
    double *v = one_of(30) ? numbers : NULL;
    void *c = one_of(100) ? s->instance : NULL;
    switch (one_of(9)) {
    case 0: took(two ? (int)fmi2SetReal(c, r, n, v) : (int)fmi3SetFloat64(c, r, n, v, m)); break;
    case 1: took(two ? (int)fmi2GetReal(c, r, n, v) : (int)fmi3GetFloat64(c, r, n, v, m)); break;
    case 2: took(two ? (int)fmi2SetInteger(c, r, n, small) : (int)fmi3SetInt64(c, r, n, integers, m)); break;
    case 3: took(two ? (int)fmi2GetInteger(c, r, n, small) : (int)fmi3GetInt64(c, r, n, integers, m)); break;
    case 4: took(two ? (int)fmi2SetString(c, r, n, texts) : (int)fmi3SetString(c, r, n, texts, n)); break;
    case 5: took(two ? (int)fmi2GetString(c, r, n, texts) : (int)fmi3GetString(c, r, n, texts, n)); break;
    case 6: took(two ? (int)fmi2SetRealInputDerivatives(c, r, n, orders, v) : (int)fmi3GetOutputDerivatives(c, r, n, NULL, v, m)); break;
    case 7: took(two ? (int)fmi2GetBoolean(c, r, n, small) : (int)fmi3GetFloat32(c, r, n, NULL, m)); break;
    default: took(two ? (int)fmi2GetRealOutputDerivatives(c, r, n, orders, v) : (int)fmi3GetInt32(c, r, n, NULL, m)); break;
    }
}

/* Inputs that a flight has, so that steps succeed now and then. */
static void fly(Slot *s, bool two) {
    unsigned refs[] = {1, 2, 3, 4, 5, 6, 7, 8};
    double x[] = {6e4 + 100.0 * one_of(300), 1000.0 + one_of(6000), 30.0 + one_of(15), 0.1 * one_of(10), one_of(5), one_of(15), 1e-5 * (1 + one_of(50)), 0.0};
    took(two ? (int)fmi2SetReal(s->instance, refs, 8, x) : (int)fmi3SetFloat64(s->instance, refs, 8, x, 8));
}

static void step(Slot *s, bool two) {
    double time = one_of(20) ? s->time : any_number(), length = one_of(6) ? 0.05 * (1 + one_of(40)) : any_number();
    bool event, end, early;
    double last = time;
    asking = s;
    int status = two ? (int)fmi2DoStep(s->instance, time, length, 1) : (int)fmi3DoStep(s->instance, time, length, true, one_of(9) ? &event : NULL, &end, &early, one_of(9) ? &last : NULL);
    asking = NULL;
    took(status);
    if (status == 0) s->time = time + length, stepped++;
}

static void states(Slot *s, bool two) {
    void **state = &s->states[one_of(STATES)], *c = s->instance;
    size_t size = 0;
    switch (one_of(6)) {
    case 0: case 1: took(two ? (int)fmi2GetFMUstate(c, state) : (int)fmi3GetFMUState(c, state)); return;
    case 2: took(two ? (int)fmi2SetFMUstate(c, *state) : (int)fmi3SetFMUState(c, *state)); break;
    case 3: took(two ? (int)fmi2FreeFMUstate(c, state) : (int)fmi3FreeFMUState(c, state)); return;
    case 4: took(two ? (int)fmi2GetFMUstate(c, NULL) : (int)fmi3SetFMUState(c, NULL)); return;
    default:
        if ((two ? (int)fmi2SerializedFMUstateSize(c, *state, &size) : (int)fmi3SerializedFMUStateSize(c, *state, &size)) != 0) return;
        char *bytes = malloc(size);
        took(two ? (int)fmi2SerializeFMUstate(c, *state, bytes, size) : (int)fmi3SerializeFMUState(c, *state, (fmi3Byte *)bytes, size));
        size_t given = one_of(3) ? size : (size_t)one_of((int)size);
        if (one_of(2)) bytes[one_of((int)size)] ^= (char)(1 << one_of(8));
        void *made = (void *)(uintptr_t)1;  /* an output: its old value is not read */
        int outcome = two ? (int)fmi2DeSerializeFMUstate(c, bytes, given, &made) : (int)fmi3DeserializeFMUState(c, (fmi3Byte *)bytes, given, &made);
        took(outcome);
        free(bytes);
        if (outcome == 0) {
            took(two ? (int)fmi2FreeFMUstate(c, state) : (int)fmi3FreeFMUState(c, state));
            *state = made;
        }
        return;
    }
    unsigned ref = 0;
    if (!two) took(fmi3GetFloat64(c, &ref, 1, &s->time, 1)); else took(fmi2GetReal(c, &ref, 1, &s->time));
}

/* States that are none of an instance's: every call that takes one refuses it. */
static void wrong_states(Slot *s, const Slot *other, bool two) {
    static void *freed[2];
    void **own = &s->states[one_of(STATES)], *c = s->instance, *number = (void *)(uintptr_t)draw(), *state = NULL;
    size_t size = 0;
    fmi3Byte bytes[8];
    if (!*own) return;
    switch (one_of(5)) {
    case 0: state = other->instance && other != s ? other->states[one_of(STATES)] : NULL; break;  /* of another instance */
    case 1: state = own; break;                                                                   /* the address of a state */
    case 2: state = number; break;
    case 3: state = freed[s->version - 2]; break;
    default:                                                                       /* a state where its address is due */
        if ((two ? (int)fmi2FreeFMUstate(c, *own) : (int)fmi3FreeFMUState(c, *own)) == 0) exit(4);
        if ((two ? (int)fmi2GetFMUstate(c, *own) : (int)fmi3GetFMUState(c, *own)) == 0) exit(4);
        return;
    }
    if (!state) return;
    void *given = state;
    if ((two ? (int)fmi2SetFMUstate(c, state) : (int)fmi3SetFMUState(c, state)) == 0) exit(4);
    if ((two ? (int)fmi2GetFMUstate(c, &given) : (int)fmi3GetFMUState(c, &given)) == 0) exit(4);
    if ((two ? (int)fmi2FreeFMUstate(c, &given) : (int)fmi3FreeFMUState(c, &given)) == 0) exit(4);
    if ((two ? (int)fmi2SerializedFMUstateSize(c, state, &size) : (int)fmi3SerializedFMUStateSize(c, state, &size)) == 0) exit(4);
    if ((two ? (int)fmi2SerializeFMUstate(c, state, (fmi2Byte *)bytes, 8) : (int)fmi3SerializeFMUState(c, state, bytes, 8)) == 0) exit(4);
    refused += 5;
    if (one_of(4) == 0) {
        freed[s->version - 2] = *own;
        took(two ? (int)fmi2FreeFMUstate(c, own) : (int)fmi3FreeFMUState(c, own));
    }
}

static void life(Slot *s, bool two) {
    void *c = one_of(100) ? s->instance : NULL;
    double start = one_of(10) ? 0.0 : any_number(), stop = one_of(10) ? 1e6 : any_number();
    switch (one_of(8)) {
    case 0: if (two) took(fmi2SetupExperiment(c, 0, 0.0, start, one_of(2), stop)); break;
    case 1: case 2: took(two ? (int)fmi2EnterInitializationMode(c) : (int)fmi3EnterInitializationMode(c, false, 0.0, start, one_of(2), stop)); break;
    case 3: case 4: took(two ? (int)fmi2ExitInitializationMode(c) : (int)fmi3ExitInitializationMode(c)); break;
    case 5: if (one_of(20) == 0) took(two ? (int)fmi2Terminate(c) : (int)fmi3Terminate(c)); break;
    case 6: took(two ? (int)fmi2CancelStep(c) : (int)fmi3EnterEventMode(c)); break;
    default: took(two ? (int)fmi2SetDebugLogging(c, one_of(2), 0, NULL) : (int)fmi3SetDebugLogging(c, one_of(2), 0, NULL)); break;
    }
    unsigned ref = 0;
    if (!two) fmi3GetFloat64(s->instance, &ref, 1, &s->time, 1); else fmi2GetReal(s->instance, &ref, 1, &s->time);
}

static void restart(Slot *s, bool two) {
    took(two ? (int)fmi2Reset(s->instance) : (int)fmi3Reset(s->instance));
    fly(s, two);
    if (two) took(fmi2SetupExperiment(s->instance, 0, 0.0, 0.0, 0, 0.0));
    took(two ? (int)fmi2EnterInitializationMode(s->instance) : (int)fmi3EnterInitializationMode(s->instance, false, 0.0, 0.0, false, 0.0));
    took(two ? (int)fmi2ExitInitializationMode(s->instance) : (int)fmi3ExitInitializationMode(s->instance));
    s->time = 0.0;
}

int main(int n, char *arguments[]) {
    if (n != 6) return printf("usage: fuzz RESOURCES TOKEN VARIABLES SEED CALLS\n"), 2;
    resources = arguments[1], token = arguments[2], n_variables = (unsigned)atoi(arguments[3]);
    seed = strtoull(arguments[4], NULL, 10) * 2654435769u + 88172645463325252ull;
    Slot slots[INSTANCES] = {{0}};
    long calls = atol(arguments[5]);
    for (long k = 0; k < calls; k++) {
        Slot *s = &slots[one_of(INSTANCES)];
        bool two = s->version == 2;
        if (!s->instance) instantiate(s);
        else if (one_of(200) == 0) drop(s);
        else switch (one_of(9)) {
        case 8: wrong_states(s, &slots[one_of(INSTANCES)], two); break;
        case 0: values(s, two); break;
        case 1: case 2: fly(s, two); break;
        case 3: case 4: step(s, two); break;
        case 5: states(s, two); break;
        case 6: life(s, two); break;
        default: if (one_of(3) == 0) restart(s, two); break;
        }
    }
    for (int k = 0; k < INSTANCES; k++)
        if (slots[k].instance) drop(&slots[k]);
    printf("calls %ld\nrefused %ld\nsteps %ld\n", calls, refused, stepped);
    return 0;
}
