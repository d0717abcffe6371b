/* Calls that take a state of an FMU with what is none, and then a proper one:   states RESOURCES TOKEN

   Writes a line a call: the version of FMI, the mistake, the function and its status. Linked with the FMU's wrapper. */

#include "fmi/fmi2Functions.h"
#include "fmi/fmi3Functions.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static const char *resources, *token;
static int version;

static void quiet(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String c, fmi2String m, ...) { (void)e, (void)name, (void)s, (void)c, (void)m; }

static void *instance(void) {
    static const fmi2CallbackFunctions functions = {quiet, calloc, free, NULL, NULL};
    void *c = version == 2 ? fmi2Instantiate("states", fmi2CoSimulation, token, resources, &functions, 0, 0)
                           : fmi3InstantiateCoSimulation("states", token, resources, false, false, false, false, NULL, 0, NULL, NULL, NULL);
    if (!c) exit(2);
    return c;
}

static void drop(void *c) { if (version == 2) fmi2FreeInstance(c); else fmi3FreeInstance(c); }
static int get(void *c, void **state) { return version == 2 ? (int)fmi2GetFMUstate(c, state) : (int)fmi3GetFMUState(c, state); }
static int set(void *c, void *state) { return version == 2 ? (int)fmi2SetFMUstate(c, state) : (int)fmi3SetFMUState(c, state); }
static int release(void *c, void **state) { return version == 2 ? (int)fmi2FreeFMUstate(c, state) : (int)fmi3FreeFMUState(c, state); }
static int measure(void *c, void *state, size_t *size) { return version == 2 ? (int)fmi2SerializedFMUstateSize(c, state, size) : (int)fmi3SerializedFMUStateSize(c, state, size); }
static int write(void *c, void *state, char *bytes, size_t size) { return version == 2 ? (int)fmi2SerializeFMUstate(c, state, bytes, size) : (int)fmi3SerializeFMUState(c, state, (fmi3Byte *)bytes, size); }
static int read(void *c, const char *bytes, size_t size, void **state) { return version == 2 ? (int)fmi2DeSerializeFMUstate(c, bytes, size, state) : (int)fmi3DeserializeFMUState(c, (const fmi3Byte *)bytes, size, state); }

static void tell(const char *mistake, const char *function, int status) { printf("%d %s: %s %d\n", version, mistake, function, status); }

/* Every function with a state that is none; NULL is one that getting and freeing take. */
static void wrong(void *c, void *state, const char *mistake) {
    static char bytes[1 << 16];
    void *given = state;
    size_t size = 0;
    tell(mistake, "set", set(c, state));
    tell(mistake, "size", measure(c, state, &size));
    tell(mistake, "serialize", write(c, state, bytes, sizeof bytes));
    if (!state) return;
    tell(mistake, "get", get(c, &given));
    tell(mistake, "free", release(c, &given));
    if (given != state) exit(3);
}

static void wrong_address(void *c, void *state, const char *mistake, const char *bytes, size_t size) {
    tell(mistake, "get", get(c, state));
    tell(mistake, "free", release(c, state));
    tell(mistake, "deserialize", read(c, bytes, size, state));
}

int main(int n, char *arguments[]) {
    if (n != 3) return 2;
    resources = arguments[1], token = arguments[2];
    for (version = 2; version <= 3; version++) {
        void *c = instance(), *other = instance(), *gone = instance();
        void *own = NULL, *freed = NULL, *others = NULL, *lost = NULL, *made = NULL;
        size_t size = 0;
        if (get(c, &own) || get(c, &freed) || get(other, &others) || get(gone, &lost)) return 2;
        void *again = freed;
        if (release(c, &freed) || freed || measure(c, own, &size)) return 2;
        drop(gone);
        char *bytes = malloc(size);
        if (!bytes || write(c, own, bytes, size)) return 2;
        wrong(c, again, "freed");
        wrong(c, others, "of another instance");
        wrong(c, lost, "of an instance that is gone");
        wrong(c, &own, "address of the state");
        wrong(c, (void *)(uintptr_t)0x1234567812345678, "number");
        wrong(c, NULL, "null");
        wrong_address(c, own, "state as the address", bytes, size);
        wrong_address(c, again, "freed state as the address", bytes, size);
        tell("proper", "set", set(c, own));
        tell("proper", "get", get(c, &own));
        tell("proper", "deserialize", read(c, bytes, size, &made));
        tell("proper", "set made", set(c, made));
        tell("proper", "free", release(c, &own));
        tell("proper", "free of another", release(other, &others));
        free(bytes);
        drop(c), drop(other);
    }
    return 0;
}
