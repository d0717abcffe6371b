/* Instances, variables, steps and states, for FMI 2 and FMI 3 alike. Memory is allocated for an instance and for states,
   and where a table takes the place of another; nothing else allocates any. */

#include "wrapper.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#if defined(__x86_64__)
#include <cpuid.h>
#ifndef bit_LZCNT
#define bit_LZCNT (1 << 5)
#endif
#endif

static const uint64_t INSTANCE = 0x73696d68656174ULL, STATE = 0x73696d7374617465ULL;
enum { LINE = 64 };      /* bytes of a cache line, on which R begins */
static const double CLOCK = 1e-9;

/* Messages -------------------------------------------------------------------------------------------------------- */

static void say(Instance *m, Status status, const char *category, const char *format, va_list arguments) {
    char text[1024];
    vsnprintf(text, sizeof text, format, arguments);
    if (m->report) m->report(m, status, category, text);
}

Status fail(Instance *m, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    say(m, ERROR, "logStatusError", format, arguments);
    va_end(arguments);
    m->mode = FAILED;
    return ERROR;
}

/* A call that is refused and leaves the instance as it is. */
Status refuse(Instance *m, const char *function, const char *why) {
    if (m && m->kind == INSTANCE) {
        char text[512];
        snprintf(text, sizeof text, "%s: %s", function, why);
        if (m->report) m->report(m, ERROR, "logStatusError", text);
    }
    return ERROR;
}

bool allowed(Instance *m, const char *function, int modes) {
    if (!m || m->kind != INSTANCE) return false;
    if (m->mode & modes) return true;
    refuse(m, function, m->mode == FAILED ? "not after an error; reset, restore a state or free the instance"
                                          : "not allowed in this mode");
    return false;
}

/* Instances ------------------------------------------------------------------------------------------------------- */

static bool make_R(Instance *m, int64_t count) {
    void *memory = malloc((size_t)count * sizeof(double) + LINE);
    if (!memory) return false;
    double *R = (double *)(void *)((char *)memory + (LINE - (uintptr_t)memory % LINE) % LINE);
    if (m->R) memcpy(R, m->R, (size_t)(count < m->n_R ? count : m->n_R) * sizeof(double));
    free(m->R_memory);
    m->R_memory = memory, m->R = R, m->n_R = count;
    return true;
}

/* True where processor and operating system support all of LLVM's x86-64-v3. */
static bool has_avx2(void) {
#if defined(__x86_64__)
    unsigned a, b, c, d, low, high;
    const unsigned first = bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C, seventh = bit_AVX2 | bit_BMI | bit_BMI2;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & first) != first) return false;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & 6) != 6) return false;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & seventh) != seventh) return false;
    return __get_cpuid(0x80000001, &a, &b, &c, &d) && (c & bit_LZCNT) != 0;
#else
    return false;
#endif
}

static const Model *best_model(void) { return &models[n_models > 1 && has_avx2() ? 1 : 0]; }

static void load(Instance *m) {
    m->n_R = m->image.n_R;
    memcpy(m->R, m->image.R, (size_t)m->image.n_R * sizeof(double));
    memcpy(m->N, m->image.N, (size_t)m->image.n_N * sizeof(int64_t));
    m->mode = INSTANTIATED;
    m->stop_defined = false, m->stop = 0.0, m->stale = true;
}

Instance *new_instance(const char *name, const char *token, const char *folder, void *environment, void *log,
                       void (*report)(Instance *, Status, const char *, const char *)) {
    Instance *m = calloc(1, sizeof(Instance));
    if (!m) return NULL;
    char why[1024] = "";
    m->kind = INSTANCE, m->environment = environment, m->log = log, m->report = report;
    size_t length = name ? strlen(name) : 0;
    m->name = calloc(length + 1, 1);
    if (m->name && name) memcpy(m->name, name, length);
    if (!m->name) {
        snprintf(why, sizeof why, "out of memory");
    } else if (length == 0) {
        snprintf(why, sizeof why, "the instance has no name");
    } else if (!folder) {
        snprintf(why, sizeof why, "the location of the resources is not given or is not a file URI");
    } else if (read_image(&m->image, folder, why, sizeof why)) {
        const char *own = m->image.text + m->image.token;
        if (!token || strcmp(token, own) != 0) {
            snprintf(why, sizeof why, "the instantiation token is %.64s, that of the resources is %.64s", token ? token : "(none)", own);
        } else {
            m->N = malloc((size_t)m->image.n_N * sizeof(int64_t));
            if (m->N && make_R(m, m->image.n_R)) {
                m->model = best_model();
                load(m);
                return m;
            }
            snprintf(why, sizeof why, "out of memory");
        }
    }
    if (report && m->name) report(m, ERROR, "logStatusError", why);
    free_instance(m);
    return NULL;
}

void free_instance(Instance *m) {
    if (!m || m->kind != INSTANCE) return;
    m->kind = 0;
    free(m->R_memory), free(m->N), free(m->name), free(m->image.memory);
    free(m);
}

Status reset(Instance *m) {
    if (!allowed(m, "reset", ANY & ~INTERMEDIATE)) return ERROR;
    load(m);
    return OK;
}

/* Variables ------------------------------------------------------------------------------------------------------- */

static const Variable *variable(Instance *m, uint32_t ref, int kind) {
    if (ref < m->image.n_variables && m->image.variables[ref].kind == kind) return &m->image.variables[ref];
    fail(m, "value reference %u is not that of a variable of this type", (unsigned)ref);
    return NULL;
}

static bool may_set(Instance *m, const Variable *v) {
    int modes = v->role == ROLE_INPUT ? SETTABLE | INTERMEDIATE
              : v->role == ROLE_TUNABLE ? SETTABLE
              : v->role == ROLE_FIXED ? INSTANTIATED | INITIALIZATION : 0;
    if (m->mode & modes) return true;
    fail(m, "%s cannot be set now", m->image.text + v->name);
    return false;
}

static Status drop_file(Instance *m, const Variable *ratios);

static void has_changed(Instance *m, const Variable *v) {
    m->stale = true;
    if (v->role != ROLE_INPUT) m->N[CHANGED] = 1;
}

static Status run(Instance *m, bool begins);

/* In initialization mode values that depend on start values are computed when they are read. */
static Status refresh(Instance *m) {
    return m->mode == INITIALIZATION && m->stale ? run(m, true) : OK;
}

Status get_numbers(Instance *m, const uint32_t *refs, size_t n, double *values, size_t n_values) {
    if (!allowed(m, "get", ANY)) return ERROR;
    if (n > 0 && (!refs || !values)) return refuse(m, "get", "no array is given");
    if (m->mode == INITIALIZATION && m->stale)
        for (size_t k = 0; k < n; k++)
            if (refs[k] < m->image.n_variables && m->image.variables[refs[k]].role == ROLE_OUTPUT && refresh(m) != OK) return ERROR;
    size_t at = 0;
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(m, refs[k], KIND_NUMBER);
        if (!v) return ERROR;
        if ((size_t)v->count > n_values - at) return fail(m, "get: %zu values hold less than the variables", n_values);
        if (v->count == 1) values[at] = m->R[v->place];
        else memcpy(values + at, m->R + v->place, (size_t)v->count * sizeof(double));
        at += (size_t)v->count;
    }
    return at == n_values ? OK : fail(m, "get: %zu values hold more than the variables", n_values);
}

static Status check(Instance *m, const Variable *v, double value) {
    const char *name = m->image.text + v->name;
    if (!isfinite(value)) return fail(m, "%s cannot be %g; it must be a finite number", name, value);
    /* The model checks the range of an input when it uses it. */
    if (v->role != ROLE_INPUT && !(v->lower <= value && value <= v->upper))
        return fail(m, "%s cannot be %g; it must be from %g to %g", name, value, v->lower, v->upper);
    return OK;
}

Status set_numbers(Instance *m, const uint32_t *refs, size_t n, const double *values, size_t n_values) {
    if (!allowed(m, "set", SETTABLE | INTERMEDIATE)) return ERROR;
    if (n > 0 && (!refs || !values)) return refuse(m, "set", "no array is given");
    size_t at = 0;
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(m, refs[k], KIND_NUMBER);
        if (!v || !may_set(m, v)) return ERROR;
        if ((size_t)v->count > n_values - at) return fail(m, "set: %zu values are less than the variables hold", n_values);
        for (int64_t i = 0; i < v->count; i++)
            if (check(m, v, values[at + (size_t)i]) != OK) return ERROR;
        if (v->role == ROLE_FIXED && drop_file(m, v) != OK) return ERROR;
        memcpy(m->R + v->place, values + at, (size_t)v->count * sizeof(double));
        at += (size_t)v->count;
        has_changed(m, v);
    }
    return at == n_values ? OK : fail(m, "set: %zu values are more than the variables hold", n_values);
}

Status get_integer(Instance *m, uint32_t ref, int64_t *value) {
    const Variable *v = variable(m, ref, KIND_INTEGER);
    if (!v) return ERROR;
    *value = m->N[v->place];
    return OK;
}

Status set_integer(Instance *m, uint32_t ref, int64_t value) {
    const Variable *v = variable(m, ref, KIND_INTEGER);
    if (!v || !may_set(m, v) || check(m, v, (double)value) != OK) return ERROR;
    m->N[v->place] = value;
    has_changed(m, v);
    return OK;
}

Status get_text(Instance *m, uint32_t ref, const char **value) {
    const Variable *v = variable(m, ref, KIND_TABLE);
    if (!v) return ERROR;
    *value = (const char *)(m->N + v->place);
    return OK;
}

/* Integers of N after a table's path: place of the tables in R, place of the name of the reference heating, the exported
   table, number of lanes that use the variable's table, and the place in N of each lane's table. Tables are
   counted from the place of the tables. */
enum { TABLES, REFERENCE_NAME, INSIDE, N_LANES, LANES };

static int64_t *table_integers(Instance *m, const Variable *v) { return m->N + v->place + TEXT_BYTES / 8; }

/* The table from a file that a variable uses, in these numbers; NULL where it uses the one inside. */
static const double *from_file(Instance *m, const Variable *v, const double *R) {
    const int64_t *own = table_integers(m, v);
    int64_t at = m->N[own[LANES]];
    return at == own[INSIDE] ? NULL : R + own[TABLES] + at;
}

/* Make a variable use a table of `count` numbers, or the exported one where it is NULL. Tables from files stand after
   the image, in the order of their variables. False where out of memory. */
static bool put_table(Instance *m, const Variable *changed, const double *table, int64_t count) {
    const Variable *first = m->image.variables, *last = first + m->image.n_variables;
    int64_t end = m->image.n_R, needed = end + count;
    const double *R = m->R;
    for (const Variable *v = first; v < last; v++) {
        const double *kept = v->kind == KIND_TABLE && v != changed ? from_file(m, v, R) : NULL;
        if (kept) needed += table_size(kept);
    }
    void *memory = m->R_memory;
    m->R_memory = NULL;
    if (!make_R(m, needed)) return m->R_memory = memory, false;
    for (const Variable *v = first; v < last; v++) {
        if (v->kind != KIND_TABLE) continue;
        const double *kept = v == changed ? table : from_file(m, v, R);
        const int64_t *own = table_integers(m, v), size = kept ? table_size(kept) : 0;
        if (kept) memcpy(m->R + end, kept, (size_t)size * sizeof(double));
        for (int64_t k = 0; k < own[N_LANES]; k++) m->N[own[LANES + k]] = kept ? end - own[TABLES] : own[INSIDE];
        end += size;
    }
    free(memory);
    return true;
}

/* Set the path of a table and read it; an empty path selects the table inside. */
Status set_text(Instance *m, uint32_t ref, const char *value) {
    const Variable *v = variable(m, ref, KIND_TABLE);
    if (!v || !may_set(m, v)) return ERROR;
    const char *name = m->image.text + v->name;
    if (!value || strlen(value) >= TEXT_BYTES) return fail(m, "%s: a path of less than %d bytes is needed", name, TEXT_BYTES);
    if (!value[0] && !from_file(m, v, m->R)) return OK;
    char why[800];
    int64_t count = 0;
    double *table = value[0] ? read_ratio_table(value, m->image.text + table_integers(m, v)[REFERENCE_NAME], &count, why, sizeof why) : NULL;
    if (value[0] && !table) return fail(m, "%s: %s", name, why);
    bool put = put_table(m, v, table, count);
    free(table);
    if (!put) return fail(m, "%s: out of memory for %.200s", name, value);
    memset(m->N + v->place, 0, TEXT_BYTES);
    memcpy(m->N + v->place, value, strlen(value));
    has_changed(m, v);
    return OK;
}

/* Ratios set as an array are those of the table inside, which then replaces that of a file: the last setting takes effect. */
static Status drop_file(Instance *m, const Variable *ratios) {
    for (int64_t i = 0; i < m->image.n_variables; i++) {
        const Variable *v = &m->image.variables[i];
        if (v->kind != KIND_TABLE || !from_file(m, v, m->R)) continue;
        const int64_t *own = table_integers(m, v), inside = own[TABLES] + own[INSIDE];
        if (ratios->place < inside || ratios->place >= inside + table_size(m->R + inside)) continue;
        if (set_text(m, (uint32_t)i, "") != OK) return ERROR;
    }
    return OK;
}

Status set_slope(Instance *m, uint32_t ref, double slope) {
    const Variable *v = variable(m, ref, KIND_NUMBER);
    if (!v) return ERROR;
    if (v->role != ROLE_INPUT || !isfinite(slope)) return fail(m, "%s: %g is not a valid derivative of an input", m->image.text + v->name, slope);
    m->R[m->N[INPUT_SLOPES] + v->place - m->N[INPUTS]] = slope;
    return OK;
}

/* Time ------------------------------------------------------------------------------------------------------------ */

static Status run(Instance *m, bool begins) {
    m->N[BEGINS] = begins;
    int64_t outcome = m->model->move(m->R, m->N, m->model->called);
    if (outcome == GOOD) {
        m->stale = false;
        return OK;
    }
    if (outcome < 0 || outcome >= m->image.n_problems) return fail(m, "the model returned an unknown outcome");
    const Problem *p = &m->image.problems[outcome];
    const char *name = m->image.text + p->name, *rule = m->image.text + p->rule;
    if (p->place < 0) return fail(m, "time %.9g s, %s: %s", m->R[NEXT], name, rule);
    int64_t k = p->place - m->N[INPUTS_NOW];
    double time = m->R[k >= 0 && k < m->N[N_INPUTS] ? NOW : NEXT];
    return fail(m, "time %.9g s: %s is %g; %s", time, name, m->R[p->place], rule);
}

Status set_experiment(Instance *m, double start, bool stop_defined, double stop) {
    if (!isfinite(start) || (stop_defined && !(stop >= start)))
        return fail(m, "start time %g and stop time %g are not valid", start, stop);
    m->R[NOW] = m->R[NEXT] = start;
    m->stop_defined = stop_defined, m->stop = stop;
    m->stale = true;
    return OK;
}

Status enter_initialization(Instance *m) {
    if (!allowed(m, "enter initialization mode", INSTANTIATED)) return ERROR;
    m->mode = INITIALIZATION;
    m->stale = true;
    return OK;
}

Status exit_initialization(Instance *m) {
    if (!allowed(m, "exit initialization mode", INITIALIZATION)) return ERROR;
    if (run(m, true) != OK) return ERROR;
    m->mode = STEPPING;
    return OK;
}

Status prepare_step(Instance *m, double time, double length) {
    if (!allowed(m, "do step", STEPPING)) return ERROR;
    double now = m->R[NOW], end = time + length;
    if (!(fabs(time - now) <= CLOCK * (1.0 + fabs(now)))) return fail(m, "the step begins at %.9g s, but the time is %.9g s", time, now);
    if (!isfinite(end) || !(length > 0.0)) return fail(m, "a step of %g s cannot be made; it must be above 0", length);
    if (!(end > now)) return fail(m, "a step of %g s is lost in rounding at %.9g s; take a longer one", length, now);
    if (m->stop_defined && end > m->stop + CLOCK * (1.0 + fabs(m->stop)))
        return fail(m, "the step ends at %.9g s, after the stop time %.9g s", end, m->stop);
    m->R[NEXT] = end;
    const int64_t *N = m->N;
    bool reached = N[TIMING] == REACHED;
    for (int64_t k = 0; k < N[N_INPUTS]; k++) {
        double *slope = &m->R[N[INPUT_SLOPES] + k], given = m->R[N[INPUTS] + k];
        m->R[N[INPUTS_NOW] + k] = reached ? m->R[N[INPUTS_NEXT] + k] : given;
        m->R[N[INPUTS_NEXT] + k] = reached ? given : given + *slope * length;
        *slope = 0.0;
    }
    return OK;
}

Status finish_step(Instance *m) {
    if (run(m, false) != OK) return ERROR;
    m->R[NOW] = m->R[NEXT];
    m->N[CHANGED] = 0;
    return OK;
}

/* States ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    uint64_t kind, sum;
    int64_t bytes, n_R, n_N, mode, stop_defined, stale;
    double stop;
    char token[64];
} StateHead;

static size_t size_of(int64_t n_R, int64_t n_N) { return sizeof(StateHead) + 8 * (size_t)(n_R + n_N); }

/* True where a state is one of this model. */
static bool ours(Instance *m, const StateHead *state) {
    return state->kind == STATE && state->n_N == m->image.n_N && state->n_R >= m->image.n_R &&
           state->bytes == (int64_t)size_of(state->n_R, state->n_N) &&
           strncmp(state->token, m->image.text + m->image.token, sizeof state->token - 1) == 0;
}

Status get_state(Instance *m, void **state) {
    if (!allowed(m, "get state", ANY & ~INTERMEDIATE)) return ERROR;
    if (!state) return refuse(m, "get state", "no pointer to it is given");
    size_t size = size_of(m->n_R, m->image.n_N);
    StateHead *head = *state;
    if (!head || head->kind != STATE || head->bytes != (int64_t)size) {
        head = malloc(size);
        if (!head) return refuse(m, "get state", "out of memory");
        if (*state && ((StateHead *)*state)->kind == STATE) free(*state);
    }
    memset(head, 0, sizeof *head);
    head->kind = STATE, head->bytes = (int64_t)size, head->n_R = m->n_R, head->n_N = m->image.n_N;
    head->mode = m->mode, head->stop_defined = m->stop_defined, head->stop = m->stop, head->stale = m->stale;
    strncpy(head->token, m->image.text + m->image.token, sizeof head->token - 1);
    memcpy(head + 1, m->R, 8 * (size_t)m->n_R);
    memcpy((char *)(head + 1) + 8 * (size_t)m->n_R, m->N, 8 * (size_t)m->image.n_N);
    *state = head;
    return OK;
}

Status set_state(Instance *m, void *state) {
    if (!allowed(m, "set state", ANY & ~INTERMEDIATE)) return ERROR;
    const StateHead *head = state;
    if (!head || !ours(m, head)) return refuse(m, "set state", "is not of this model");
    if (head->n_R != m->n_R && !make_R(m, head->n_R)) return refuse(m, "set state", "out of memory");
    memcpy(m->R, head + 1, 8 * (size_t)m->n_R);
    memcpy(m->N, (const char *)(head + 1) + 8 * (size_t)m->n_R, 8 * (size_t)m->image.n_N);
    m->mode = (Mode)head->mode, m->stop_defined = head->stop_defined != 0, m->stop = head->stop, m->stale = head->stale != 0;
    return OK;
}

Status free_state(Instance *m, void **state) {
    if (!allowed(m, "free state", ANY)) return ERROR;
    if (!state || !*state) return OK;
    if (((StateHead *)*state)->kind != STATE) return refuse(m, "free state", "is not a state");
    ((StateHead *)*state)->kind = 0;
    free(*state);
    *state = NULL;
    return OK;
}

Status state_size(Instance *m, void *state, size_t *size) {
    if (!allowed(m, "size of state", ANY)) return ERROR;
    if (!state || !size || !ours(m, state)) return refuse(m, "size of state", "is not of this model");
    *size = (size_t)((StateHead *)state)->bytes;
    return OK;
}

Status serialize(Instance *m, void *state, void *bytes, size_t size) {
    if (!allowed(m, "serialize state", ANY)) return ERROR;
    if (!state || !bytes || !ours(m, state)) return refuse(m, "serialize state", "is not of this model");
    StateHead *head = state;
    if (size < (size_t)head->bytes) return refuse(m, "serialize state", "does not fit");
    head->sum = 0;
    head->sum = checksum(head, (size_t)head->bytes);
    memcpy(bytes, head, (size_t)head->bytes);
    return OK;
}

Status deserialize(Instance *m, const void *bytes, size_t size, void **state) {
    if (!allowed(m, "deserialize state", ANY)) return ERROR;
    if (!bytes || !state || size < sizeof(StateHead)) return refuse(m, "deserialize state", "no state is given");
    StateHead *head = malloc(size);
    if (!head) return refuse(m, "deserialize state", "out of memory");
    memcpy(head, bytes, size);
    uint64_t stored = head->sum;
    head->sum = 0;
    if (head->kind != STATE || head->bytes != (int64_t)size || checksum(head, size) != stored || !ours(m, head)) {
        free(head);
        return refuse(m, "deserialize state", "is damaged, or of another model");
    }
    *state = head;
    return OK;
}
