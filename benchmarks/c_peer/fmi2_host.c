/* A plain C host of any FMI 2.0 co-simulation FMU: sets inputs, steps and reads outputs, frame by frame.

       fmi2_host LIBRARY GUID RESOURCES FRAMES.csv INPUTS OUTPUTS [INTEGER=VALUE] > outputs.csv

   INPUTS, OUTPUTS : value references of Reals, comma between; inputs as the columns of FRAMES.csv behind its time
   INTEGER=VALUE   : value reference and value of an Integer set before initialization

   On standard error: microseconds of fmi2SetReal, fmi2DoStep and fmi2GetReal, in the fastest run of MEAN frames. */

#include "fmi/fmi2FunctionTypes.h"
#include "host/host.h"

#include <dlfcn.h>
#include <stdarg.h>
#include <string.h>

enum { SET = 0, STEP, GET, PARTS };

typedef struct { fmi2ValueReference refs[MOST]; size_t count; } Refs;

static void log_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String message, ...) {
    (void)environment, (void)name, (void)category;
    va_list arguments;
    va_start(arguments, message);
    fprintf(stderr, "fmu (%d): ", (int)status);
    vfprintf(stderr, message, arguments);
    fprintf(stderr, "\n");
    va_end(arguments);
}

static Refs references(char *list) {
    Refs found = {.count = 0};
    for (char *at = strtok(list, ","); at && found.count < MOST; at = strtok(NULL, ","))
        found.refs[found.count++] = (fmi2ValueReference)strtoul(at, NULL, 10);
    return found;
}

static void *function(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) stop("the library lacks ", name);
    return found;
}

static void check(fmi2Status status, const char *what) {
    if (status != fmi2OK) stop("failed: ", what);
}

int main(int n, char *arguments[]) {
    if (n < 7) stop("usage: fmi2_host LIBRARY GUID RESOURCES FRAMES.csv INPUTS OUTPUTS [INTEGER=VALUE]", "");
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) stop("cannot load: ", dlerror());
    fmi2InstantiateTYPE *instantiate;
    fmi2SetupExperimentTYPE *setup;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
    fmi2SetRealTYPE *set;
    fmi2GetRealTYPE *get;
    fmi2SetIntegerTYPE *set_integer;
    fmi2DoStepTYPE *step;
    fmi2TerminateTYPE *terminate;
    fmi2FreeInstanceTYPE *release;
    *(void **)&instantiate = function(library, "fmi2Instantiate");
    *(void **)&setup = function(library, "fmi2SetupExperiment");
    *(void **)&enter = function(library, "fmi2EnterInitializationMode");
    *(void **)&leave = function(library, "fmi2ExitInitializationMode");
    *(void **)&set = function(library, "fmi2SetReal");
    *(void **)&get = function(library, "fmi2GetReal");
    *(void **)&set_integer = function(library, "fmi2SetInteger");
    *(void **)&step = function(library, "fmi2DoStep");
    *(void **)&terminate = function(library, "fmi2Terminate");
    *(void **)&release = function(library, "fmi2FreeInstance");

    FILE *frames = fopen(arguments[4], "r");
    double row[MOST], out[MOST], spent[PARTS] = {0}, fastest[PARTS] = {1e9, 1e9, 1e9};
    char heads[LINE];
    if (!frames || !fgets(heads, sizeof heads, frames)) stop("cannot read ", arguments[4]);
    Refs inputs = references(arguments[5]), outputs = references(arguments[6]);
    if (read_line(frames, row) != inputs.count + 1) stop("columns are not a time and the inputs: ", arguments[4]);

    fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    fmi2Component fmu = instantiate("host", fmi2CoSimulation, arguments[2], arguments[3], &callbacks, fmi2False, fmi2False);
    if (!fmu) stop("cannot be instantiated: ", arguments[1]);
    if (n > 7) {
        char *end;
        fmi2ValueReference ref = (fmi2ValueReference)strtoul(arguments[7], &end, 10);
        fmi2Integer value = (fmi2Integer)strtol(end + 1, NULL, 10);
        check(set_integer(fmu, &ref, 1, &value), "fmi2SetInteger");
    }
    double time = row[0];
    check(setup(fmu, fmi2False, 0.0, time, fmi2False, 0.0), "fmi2SetupExperiment");
    check(enter(fmu), "fmi2EnterInitializationMode");
    check(set(fmu, inputs.refs, inputs.count, row + 1), "fmi2SetReal");
    check(leave(fmu), "fmi2ExitInitializationMode");
    for (size_t frame = 1; read_line(frames, row) > 0; frame++) {
        double began = now();
        check(set(fmu, inputs.refs, inputs.count, row + 1), "fmi2SetReal");
        double given = now();
        check(step(fmu, time, row[0] - time, fmi2True), "fmi2DoStep");
        double stepped = now();
        check(get(fmu, outputs.refs, outputs.count, out), "fmi2GetReal");
        double read = now();
        time = row[0];
        spent[SET] += given - began, spent[STEP] += stepped - given, spent[GET] += read - stepped;
        if (frame % MEAN == 0) {
            if (spent[SET] + spent[STEP] + spent[GET] < MEAN * (fastest[SET] + fastest[STEP] + fastest[GET]))
                for (int k = 0; k < PARTS; k++) fastest[k] = spent[k] / MEAN;
            memset(spent, 0, sizeof spent);
        }
        printf("%.17g", time);
        for (size_t k = 0; k < outputs.count; k++) printf(",%.17g", out[k]);
        printf("\n");
    }
    fprintf(stderr, "set_us %.3f\nstep_us %.3f\nget_us %.3f\n", 1e6 * fastest[SET], 1e6 * fastest[STEP], 1e6 * fastest[GET]);
    check(terminate(fmu), "fmi2Terminate");
    release(fmu);
    fflush(NULL);
    _Exit(0);   /* a Python within an FMU may not survive what a library does at the end of a process */
}
