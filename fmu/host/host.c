/* A plain C host of an exported heating FMU (FMI 3.0): flies a table of conditions and writes what was asked for.

       cc -std=c11 -O2 -I fmu -o host fmu/host/host.c -ldl
       unzip -q orbiter.fmu -d orbiter
       ./host orbiter reached conditions.csv V09T9527.surface_K V09T9527.bondline_K > temperatures.csv

   Columns of conditions.csv: time_s, then inputs of the FMU by their names; others, as those of `sim-heating run`, are
   skipped and told. How inputs are meant, second argument:

       reached   values at the end of a step, reached along a straight line: what a host gives that has flown the step
       held      values at the start of a step, held over it
       updated   values at the start; those at the end are given when the FMU asks for them (intermediate update)

   On standard error: time to instantiate, and a step's (inputs set and doStep): the fastest mean of MEAN in a row. */

#include "fmi/fmi3FunctionTypes.h"
#include "host.h"

#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#include <windows.h>
#define LIBRARY "binaries/x86_64-windows/%s.dll"
static void *open_library(const char *path) { return (void *)LoadLibraryA(path); }
static void *find(void *library, const char *name) { return (void *)(intptr_t)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
#if defined(__APPLE__) && defined(__aarch64__)
#define LIBRARY "binaries/aarch64-darwin/%s.dylib"
#elif defined(__APPLE__)
#define LIBRARY "binaries/x86_64-darwin/%s.dylib"
#elif defined(__aarch64__)
#define LIBRARY "binaries/aarch64-linux/%s.so"
#else
#define LIBRARY "binaries/x86_64-linux/%s.so"
#endif
static void *open_library(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void *find(void *library, const char *name) { return dlsym(library, name); }
#endif

static struct {
    void *library;
    fmi3InstantiateCoSimulationTYPE *instantiate;
    fmi3EnterInitializationModeTYPE *enter;
    fmi3ExitInitializationModeTYPE *leave;
    fmi3SetFloat64TYPE *set;
    fmi3GetFloat64TYPE *get;
    fmi3SetInt64TYPE *set_integer;
    fmi3DoStepTYPE *step;
    fmi3TerminateTYPE *terminate;
    fmi3FreeInstanceTYPE *free;
} fmu;

typedef struct { fmi3Instance instance; fmi3ValueReference refs[MOST]; size_t count; double *next; } Flown;

static char *read_whole(const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file) stop("cannot read ", path);
    fseek(file, 0, SEEK_END);
    long size = ftell(file);
    rewind(file);
    char *text = malloc((size_t)size + 1);
    if (!text || fread(text, 1, (size_t)size, file) != (size_t)size) stop("cannot read ", path);
    text[size] = 0;
    fclose(file);
    return text;
}

/* Value of an attribute of the element that begins at `element`. The description is this project's own, so plain text
   search will do; a host of any FMU takes an XML parser. */
static char *attribute(const char *element, const char *name) {
    char key[64];
    snprintf(key, sizeof key, " %s=\"", name);
    const char *end = strchr(element, '>'), *at = strstr(element, key);
    if (!at || at > end) stop("the description lacks ", name);
    at += strlen(key);
    size_t length = (size_t)(strchr(at, '"') - at);
    char *value = calloc(length + 1, 1);
    return value ? memcpy(value, at, length) : NULL;
}

/* The element of a variable in the description, NULL where there is none. */
static const char *variable(const char *description, const char *name) {
    char key[LINE];
    snprintf(key, sizeof key, " name=\"%s\" valueReference=", name);
    return strstr(description, key);
}

static fmi3ValueReference reference(const char *description, const char *name) {
    const char *at = variable(description, name);
    if (!at) stop("the FMU has no variable ", name);
    return (fmi3ValueReference)strtoul(attribute(at, "valueReference"), NULL, 10);
}

static void *function(const char *name) {
    void *found = find(fmu.library, name);
    if (!found) stop("the library lacks ", name);
    return found;
}

static void load(const char *path) {
    fmu.library = open_library(path);
    if (!fmu.library) stop("cannot load ", path);
    *(void **)&fmu.instantiate = function("fmi3InstantiateCoSimulation");
    *(void **)&fmu.enter = function("fmi3EnterInitializationMode");
    *(void **)&fmu.leave = function("fmi3ExitInitializationMode");
    *(void **)&fmu.set = function("fmi3SetFloat64");
    *(void **)&fmu.get = function("fmi3GetFloat64");
    *(void **)&fmu.set_integer = function("fmi3SetInt64");
    *(void **)&fmu.step = function("fmi3DoStep");
    *(void **)&fmu.terminate = function("fmi3Terminate");
    *(void **)&fmu.free = function("fmi3FreeInstance");
}

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment;
    fprintf(stderr, "fmu (%d, %s): %s\n", (int)status, category, message);
}

static void intermediate(fmi3InstanceEnvironment environment, double time, bool set, bool get, bool finished, bool may_stop,
                         bool *stop_asked, double *stop_time) {
    (void)time, (void)get, (void)finished, (void)may_stop, (void)stop_asked, (void)stop_time;
    Flown *flown = environment;
    if (set) fmu.set(flown->instance, flown->refs, flown->count, flown->next, flown->count);
}

/* The next row of the conditions: its time, then the columns that are inputs; 0 behind the last row. */
static size_t read_inputs(FILE *file, const size_t columns[], size_t count, double row[]) {
    double all[MOST];
    size_t found = read_line(file, all);
    if (!found) return 0;
    row[0] = all[0];
    for (size_t k = 0; k < count; k++) {
        if (columns[k] >= found) stop("a row of the conditions is too short", "");
        row[k + 1] = all[columns[k]];
    }
    return found;
}

int main(int n, char *arguments[]) {
    if (n < 5) stop("usage: host FOLDER reached|held|updated CONDITIONS.csv OUTPUT...", "");
    char path[LINE], names[LINE], resources[LINE];
    snprintf(path, sizeof path, "%s/modelDescription.xml", arguments[1]);
    snprintf(resources, sizeof resources, "%s/resources/", arguments[1]);
    char *description = read_whole(path);
    const char *root = strstr(description, "<fmiModelDescription"), *model = strstr(description, "<CoSimulation");
    char file[LINE / 2];
    snprintf(file, sizeof file, LIBRARY, attribute(model, "modelIdentifier"));
    snprintf(path, sizeof path, "%s/%s", arguments[1], file);
    load(path);

    bool reached = strcmp(arguments[2], "reached") == 0, updated = strcmp(arguments[2], "updated") == 0;
    FILE *conditions = fopen(arguments[3], "r");
    if (!conditions || !fgets(names, sizeof names, conditions)) stop("cannot read ", arguments[3]);
    Flown flown = {0};
    strtok(names, ",\r\n");
    size_t columns[MOST], column = 1, skipped = 0;
    for (char *name; (name = strtok(NULL, ",\r\n")) && column < MOST; column++) {
        const char *found = variable(description, name);
        if (!found || strcmp(attribute(found, "causality"), "input") != 0) {
            fprintf(stderr, "%s%s", skipped++ ? ", " : "host: columns that are no inputs of the FMU, skipped: ", name);
            continue;
        }
        columns[flown.count] = column;
        flown.refs[flown.count++] = reference(description, name);
    }
    if (skipped) fprintf(stderr, "\n");
    if (!flown.count) stop("no column is an input of the FMU: ", arguments[3]);
    fmi3ValueReference wanted[MOST], timing = reference(description, "input_timing");
    size_t n_wanted = 0;
    for (int k = 4; k < n && n_wanted < MOST; k++) wanted[n_wanted++] = reference(description, arguments[k]);

    double began = now();
    flown.instance = fmu.instantiate("host", attribute(root, "instantiationToken"), resources, false, false, false, false,
                                     NULL, 0, &flown, log_message, updated ? intermediate : NULL);
    if (!flown.instance) return 1;
    double instantiated = now() - began, row[2][MOST], out[MOST], spent = 0.0, fastest = 1e9;
    int64_t meaning = reached ? 2 : 1;
    int current = 0, steps = 0;
    if (!read_inputs(conditions, columns, flown.count, row[0])) stop("there are no conditions in ", arguments[3]);
    bool good = fmu.set_integer(flown.instance, &timing, 1, &meaning, 1) == fmi3OK &&
                fmu.enter(flown.instance, false, 0.0, row[0][0], false, 0.0) == fmi3OK &&
                fmu.set(flown.instance, flown.refs, flown.count, row[0] + 1, flown.count) == fmi3OK &&
                fmu.leave(flown.instance) == fmi3OK;
    printf("time_s");
    for (int k = 4; k < n; k++) printf(",%s", arguments[k]);
    for (double time = row[0][0]; good; steps++) {
        fmu.get(flown.instance, wanted, n_wanted, out, n_wanted);
        printf("\n%.17g", time);
        for (size_t k = 0; k < n_wanted; k++) printf(",%.17g", out[k]);
        double *last = row[current], *next = row[current = 1 - current];
        if (!read_inputs(conditions, columns, flown.count, next)) break;
        bool event, end, early;
        double done, at = now();
        flown.next = next + 1;
        good = fmu.set(flown.instance, flown.refs, flown.count, (reached ? next : last) + 1, flown.count) == fmi3OK &&
               fmu.step(flown.instance, time, next[0] - time, true, &event, &end, &early, &done) == fmi3OK;
        spent += now() - at;
        if (steps % MEAN == MEAN - 1) {
            fastest = spent < MEAN * fastest ? spent / MEAN : fastest;
            spent = 0.0;
        }
        time = done;
    }
    printf("\n");
    if (good) fmu.terminate(flown.instance);
    fmu.free(flown.instance);
    fprintf(stderr, "instantiate_ms %.3f\nsteps %d\nfastest_step_us %.3f\n", 1e3 * instantiated, steps, 1e6 * fastest);
    return good ? 0 : 1;
}
