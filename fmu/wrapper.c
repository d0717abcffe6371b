/* Instances, variables, steps and states, for FMI 2 and FMI 3 alike. Memory is allocated for an instance, for states, where a
   table takes the place of another, and for a workspace the first time that so many instances are at work at once.

   What belongs to an instance alone are the kept runs of R and N, some ten numbers a node. It is in its buffer `kept`, or in
   the workspace that it used last, until another instance needs that: what one wrote is then copied away, and what the other
   kept is copied in. An instance that works alone copies nothing. */

#include "wrapper.h"

#include <math.h>
#include <stdarg.h>
#include <stdatomic.h>
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
enum { WORKSPACES = 2 }; /* that remain idle; more where more instances are at work at once */
static const double CLOCK = 1e-9;
static uint64_t turn;    /* counts uses of workspaces */

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

/* The same for a function that needs the whole instance, and is not to be called from within another one. */
static bool allowed_between(Instance *m, const char *function) {
    if (!allowed(m, function, ANY & ~INTERMEDIATE)) return false;
    return m->held == 0 || (refuse(m, function, "not allowed in the intermediate update"), false);
}

/* Workspaces ------------------------------------------------------------------------------------------------------ */

static void copy_away(const Image *im, const Workspace *w, uint64_t *kept) {
    for (const Run *r = im->kept_R, *end = r + im->n_kept_R; r < end; kept += r++->count) memcpy(kept, w->R + r->place, 8 * (size_t)r->count);
    for (const Run *r = im->kept_N, *end = r + im->n_kept_N; r < end; kept += r++->count) memcpy(kept, w->N + r->place, 8 * (size_t)r->count);
}

static void copy_in(const Image *im, Workspace *w, const uint64_t *kept) {
    for (const Run *r = im->kept_R, *end = r + im->n_kept_R; r < end; kept += r++->count) memcpy(w->R + r->place, kept, 8 * (size_t)r->count);
    for (const Run *r = im->kept_N, *end = r + im->n_kept_N; r < end; kept += r++->count) memcpy(w->N + r->place, kept, 8 * (size_t)r->count);
}

static void fill(const Image *im, Workspace *w) {
    memcpy(w->R, im->R, 8 * (size_t)im->n_R);
    memcpy(w->N, im->N, 8 * (size_t)im->n_N);
    w->spoiled = false;
}

/* A new workspace, busy and nobody's, in the list of its image; NULL where out of memory. */
static Workspace *new_workspace(Image *im) {
    Workspace *w = calloc(1, sizeof *w);
    if (w) w->memory = malloc(8 * (size_t)(im->n_R + im->n_N) + LINE);
    if (!w || !w->memory) return free(w), NULL;
    w->R = (double *)(void *)((char *)w->memory + (LINE - (uintptr_t)w->memory % LINE) % LINE);
    w->N = (int64_t *)(void *)(w->R + im->n_R);
    w->busy = true;
    fill(im, w);
    take_lock();
    w->next = im->workspaces, im->workspaces = w;
    drop_lock();
    return w;
}

/* An idle workspace, nobody's or else the one not used for longest; NULL where a new one is better. With the lock. */
static Workspace *idle_workspace(Image *im) {
    Workspace *oldest = NULL;
    int count = 0;
    for (Workspace *w = im->workspaces; w; w = w->next, count++) {
        if (w->busy) continue;
        if (!w->owner) return w;
        if (!oldest || w->turn < oldest->turn) oldest = w;
    }
    return count < WORKSPACES ? NULL : oldest;
}

/* The workspace of an instance, made busy; NULL where it has none. */
static Workspace *own_workspace(Instance *m) {
    for (;; drop_lock()) {
        take_lock();
        Workspace *w = m->workspace;
        if (w && w->busy) continue;                            /* its state is being copied away by another thread */
        if (w) w->busy = true, w->turn = ++turn;
        drop_lock();
        return w;
    }
}

/* Forget what the workspace of an instance holds. */
static void leave_workspace(Instance *m) {
    Workspace *w = own_workspace(m);
    if (!w) return;
    take_lock();
    w->owner = NULL, w->busy = false;
    m->workspace = NULL;
    drop_lock();
}

static void place_tables(Instance *m);

/* A workspace with the state of an instance; NULL where out of memory. */
static Workspace *work(Instance *m) {
    Workspace *w = own_workspace(m);
    if (w) return w;
    Image *im = m->image;
    take_lock();
    w = idle_workspace(im);
    Instance *before = w ? w->owner : NULL;
    if (w) w->busy = true, w->turn = ++turn;
    drop_lock();
    if (!w && !(w = new_workspace(im))) return NULL;
    if (before) copy_away(im, w, before->kept);
    if (w->spoiled) fill(im, w);
    copy_in(im, w, m->kept);
    w->resumed = false;
    take_lock();
    if (before) before->workspace = NULL;
    w->owner = m, m->workspace = w;
    drop_lock();
    m->R = w->R, m->N = w->N;
    place_tables(m);
    return w;
}

bool hold(Instance *m, const char *function, int modes) {
    if (!allowed(m, function, modes)) return false;
    if (m->held == 0) {
        Workspace *w = work(m);
        if (!w) return refuse(m, function, "out of memory"), false;
        m->R = w->R, m->N = w->N;
    }
    m->held++;
    return true;
}

Status release(Instance *m, Status status) {
    if (--m->held == 0) {
        take_lock();
        m->workspace->busy = false;
        drop_lock();
        m->R = NULL, m->N = NULL;
    }
    return status;
}

/* Tables ---------------------------------------------------------------------------------------------------------- */

static const int64_t *table_integers(const Image *im, int64_t table) { return im->N + im->variables[im->tables[table]].place; }

static const double *inside(const Image *im, int64_t table) { return im->T + table_integers(im, table)[TABLE_INSIDE]; }

static int64_t inside_size(const Image *im, int64_t table) {
    return table_size(inside(im, table), im->n_T - table_integers(im, table)[TABLE_INSIDE]);
}

static Table *new_table(const double *values, int64_t count, const char *path) {
    size_t numbers = (size_t)count * sizeof(double), length = strlen(path) + 1;
    Table *table = malloc(sizeof *table + numbers + length);
    if (!table) return NULL;
    table->users = 1, table->count = count;
    memcpy(table->values, values, numbers);
    table->path = memcpy((char *)table->values + numbers, path, length);
    return table;
}

static void drop_table(Table **table) {
    if (*table && --(*table)->users == 0) free(*table);
    *table = NULL;
}

static void drop_tables(const Image *im, Own *own) {
    for (int64_t k = 0; own && k < im->n_tables; k++) drop_table(&own[k].array), drop_table(&own[k].file);
}

static void share_tables(const Image *im, Own *to, const Own *from) {
    for (int64_t k = 0; k < im->n_tables; k++) {
        if (from[k].array) from[k].array->users++;
        if (from[k].file) from[k].file->users++;
    }
    drop_tables(im, to);
    memcpy(to, from, (size_t)im->n_tables * sizeof *to);
}

/* Tell the lanes of all tables which ones are in use. With the workspace. */
static void place_tables(Instance *m) {
    const Image *im = m->image;
    for (int64_t k = 0; k < im->n_tables; k++) {
        const int64_t *about = table_integers(im, k);
        const Table *own = m->own[k].file ? m->own[k].file : m->own[k].array;
        /* Own tables lie outside T: lanes reach them by their distance, of either sign. */
        int64_t place = own ? ((intptr_t)own->values - (intptr_t)im->T) / (intptr_t)sizeof(double) : about[TABLE_INSIDE];
        for (int64_t lane = 0; lane < about[TABLE_N_LANES]; lane++) m->N[about[TABLE_LANES + lane]] = place;
    }
}

/* Numbers of a variable: its own where they were set, else those that all instances share. With the workspace. */
static const double *numbers(const Instance *m, const Variable *v) {
    if (v->kind == KIND_NUMBER) return m->R + v->place;
    int64_t table = m->image->table_of[v - m->image->variables];
    const Table *own = m->own[table].array;
    return own ? own->values + (v->place - table_integers(m->image, table)[TABLE_INSIDE]) : m->image->T + v->place;
}

/* The same to write into: an array is copied before it is first written. NULL where out of memory. */
static double *writable(Instance *m, const Variable *v) {
    if (v->kind == KIND_NUMBER) return m->R + v->place;
    int64_t k = m->image->table_of[v - m->image->variables];
    Table *before = m->own[k].array;
    if (!before || before->users > 1) {
        Table *copy = new_table(before ? before->values : inside(m->image, k), inside_size(m->image, k), "");
        if (!copy) return NULL;
        drop_table(&m->own[k].array);
        m->own[k].array = copy;
    }
    drop_table(&m->own[k].file);                               /* the last setting takes effect */
    place_tables(m);
    return m->own[k].array->values + (v->place - table_integers(m->image, k)[TABLE_INSIDE]);
}

/* Instances ------------------------------------------------------------------------------------------------------- */

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
    memcpy(m->kept, m->image->initial, 8 * (size_t)m->image->n_kept);
    drop_tables(m->image, m->own);
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
    } else if ((m->image = share_image(folder, why, sizeof why))) {
        const char *own = m->image->text + m->image->token;
        if (!token || strcmp(token, own) != 0) {
            snprintf(why, sizeof why, "the instantiation token is %.64s, that of the resources is %.64s", token ? token : "(none)", own);
        } else {
            m->kept = malloc(8 * (size_t)m->image->n_kept);
            m->own = calloc((size_t)m->image->n_tables + 1, sizeof *m->own);
            if (m->kept && m->own) {
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

static void drop_state(Instance *m, State *state);

void free_instance(Instance *m) {
    if (!m || m->kind != INSTANCE) return;
    leave_workspace(m);
    while (m->states) drop_state(m, m->states);
    m->kind = 0;
    if (m->own) drop_tables(m->image, m->own);
    drop_image(m->image);
    free(m->kept), free(m->own), free(m->name);
    free(m);
}

Status reset(Instance *m) {
    if (!allowed_between(m, "reset")) return ERROR;
    leave_workspace(m);
    load(m);
    return OK;
}

/* Variables ------------------------------------------------------------------------------------------------------- */

static const Variable *variable(Instance *m, uint32_t ref, int kind) {
    const Image *im = m->image;
    if (ref < im->n_variables) {
        const Variable *v = &im->variables[ref];
        if (v->kind == kind || (kind == KIND_NUMBER && v->kind == KIND_SHARED)) return v;
    }
    fail(m, "value reference %u is not that of a variable of this type", (unsigned)ref);
    return NULL;
}

static bool may_set(Instance *m, const Variable *v) {
    int modes = v->role == ROLE_INPUT ? SETTABLE | INTERMEDIATE
              : v->role == ROLE_TUNABLE ? SETTABLE
              : v->role == ROLE_FIXED ? INSTANTIATED | INITIALIZATION : 0;
    if (m->mode & modes) return true;
    fail(m, "%s cannot be set now", m->image->text + v->name);
    return false;
}

static void has_changed(Instance *m, const Variable *v) {
    m->stale = true;
    if (v->role != ROLE_INPUT) m->N[CHANGED] = 1;
}

static Status run(Instance *m, int what);

/* In initialization mode values that depend on start values are computed when they are read. */
static Status refresh(Instance *m) {
    return m->mode == INITIALIZATION && m->stale ? run(m, START) : OK;
}

static Status get_each(Instance *m, const uint32_t *refs, size_t n, double *values, size_t n_values) {
    if (m->mode == INITIALIZATION && m->stale)
        for (size_t k = 0; k < n; k++)
            if (refs[k] < m->image->n_variables && m->image->variables[refs[k]].role == ROLE_OUTPUT && refresh(m) != OK) return ERROR;
    size_t at = 0;
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(m, refs[k], KIND_NUMBER);
        if (!v) return ERROR;
        if ((size_t)v->count > n_values - at) return fail(m, "get: %zu values hold less than the variables", n_values);
        const double *from = numbers(m, v);
        if (v->count == 1) values[at] = *from;
        else memcpy(values + at, from, (size_t)v->count * sizeof(double));
        at += (size_t)v->count;
    }
    return at == n_values ? OK : fail(m, "get: %zu values hold more than the variables", n_values);
}

Status get_numbers(Instance *m, const uint32_t *refs, size_t n, double *values, size_t n_values) {
    if (!hold(m, "get", ANY)) return ERROR;
    if (n > 0 && (!refs || !values)) return release(m, refuse(m, "get", "no array is given"));
    return release(m, get_each(m, refs, n, values, n_values));
}

static Status check(Instance *m, const Variable *v, double value) {
    const char *name = m->image->text + v->name;
    if (!isfinite(value)) return fail(m, "%s cannot be %g; it must be a finite number", name, value);
    /* The model checks the range of an input when it uses it. */
    if (v->role != ROLE_INPUT && !(v->lower <= value && value <= v->upper))
        return fail(m, "%s cannot be %g; it must be from %g to %g", name, value, v->lower, v->upper);
    return OK;
}

static Status set_each(Instance *m, const uint32_t *refs, size_t n, const double *values, size_t n_values) {
    size_t at = 0;
    for (size_t k = 0; k < n; k++) {
        const Variable *v = variable(m, refs[k], KIND_NUMBER);
        if (!v || !may_set(m, v)) return ERROR;
        if ((size_t)v->count > n_values - at) return fail(m, "set: %zu values are less than the variables hold", n_values);
        for (int64_t i = 0; i < v->count; i++)
            if (check(m, v, values[at + (size_t)i]) != OK) return ERROR;
        double *to = writable(m, v);
        if (!to) return fail(m, "%s: out of memory", m->image->text + v->name);
        memcpy(to, values + at, (size_t)v->count * sizeof(double));
        at += (size_t)v->count;
        has_changed(m, v);
    }
    return at == n_values ? OK : fail(m, "set: %zu values are more than the variables hold", n_values);
}

Status set_numbers(Instance *m, const uint32_t *refs, size_t n, const double *values, size_t n_values) {
    if (!hold(m, "set", SETTABLE | INTERMEDIATE)) return ERROR;
    if (n > 0 && (!refs || !values)) return release(m, refuse(m, "set", "no array is given"));
    return release(m, set_each(m, refs, n, values, n_values));
}

Status get_integer(Instance *m, uint32_t ref, int64_t *value) {
    const Variable *v = variable(m, ref, KIND_INTEGER);
    if (!v || !hold(m, "get", ANY)) return ERROR;
    *value = m->N[v->place];
    return release(m, OK);
}

Status set_integer(Instance *m, uint32_t ref, int64_t value) {
    const Variable *v = variable(m, ref, KIND_INTEGER);
    if (!v || !may_set(m, v) || check(m, v, (double)value) != OK || !hold(m, "set", SETTABLE)) return ERROR;
    m->N[v->place] = value;
    has_changed(m, v);
    return release(m, OK);
}

int64_t timing(const Instance *m) { return m->N[TIMING_INTEGER] ? m->N[TIMING_INTEGER] : m->N[TIMING]; }

Status get_text(Instance *m, uint32_t ref, const char **value) {
    const Variable *v = variable(m, ref, KIND_TABLE);
    if (!v) return ERROR;
    const Table *file = m->own[m->image->table_of[ref]].file;
    *value = file ? file->path : "";
    return OK;
}

/* Set the path of a table and read it; an empty path selects the table inside. */
Status set_text(Instance *m, uint32_t ref, const char *value) {
    const Variable *v = variable(m, ref, KIND_TABLE);
    if (!v || !may_set(m, v)) return ERROR;
    const char *name = m->image->text + v->name;
    if (!value || strlen(value) >= TEXT_BYTES) return fail(m, "%s: a path of less than %d bytes is needed", name, TEXT_BYTES);
    int64_t k = m->image->table_of[ref], count = 0;
    if (!value[0] && !m->own[k].file) return OK;
    Table *table = NULL;
    if (value[0]) {
        char why[800];
        const char *text = m->image->text;
        const int64_t *about = table_integers(m->image, k);
        RatioBasis basis = {text + about[TABLE_REFERENCE], text + about[TABLE_RECOVERY], text + about[TABLE_UNSTATED]};
        double *read = read_ratio_table(value, basis, &count, why, sizeof why);
        if (!read) return fail(m, "%s: %s", name, why);
        table = new_table(read, count, value);
        free(read);
        if (!table) return fail(m, "%s: out of memory for %.200s", name, value);
    }
    if (!hold(m, "set", SETTABLE)) return drop_table(&table), ERROR;
    drop_table(&m->own[k].file);
    m->own[k].file = table;
    place_tables(m);
    has_changed(m, v);
    return release(m, OK);
}

Status set_slope(Instance *m, uint32_t ref, double slope) {
    const Variable *v = variable(m, ref, KIND_NUMBER);
    if (!v) return ERROR;
    if (v->role != ROLE_INPUT || !isfinite(slope)) return fail(m, "%s: %g is not a valid derivative of an input", m->image->text + v->name, slope);
    if (!hold(m, "set", ANY)) return ERROR;
    m->R[m->N[INPUT_SLOPES] + v->place - m->N[INPUTS]] = slope;
    return release(m, OK);
}

/* Time ------------------------------------------------------------------------------------------------------------ */

/* Run the model. With the workspace. */
static Status run(Instance *m, int what) {
    Workspace *w = m->workspace;
    if (!w->resumed) {
        m->N[MODE] = RESUME;
        m->model->move(m->R, m->N, m->model->called, m->image->T);
        w->resumed = true;
    }
    m->N[MODE] = what;
    int64_t outcome = m->model->move(m->R, m->N, m->model->called, m->image->T);
    if (outcome == GOOD) {
        m->stale = false;
        return OK;
    }
    w->spoiled = true;
    if (outcome < 0 || outcome >= m->image->n_problems) return fail(m, "the model returned an unknown outcome");
    const Problem *p = &m->image->problems[outcome];
    const char *name = m->image->text + p->name, *rule = m->image->text + p->rule;
    if (p->place < 0) return fail(m, "time %.9g s, %s: %s", m->R[NEXT], name, rule);
    int64_t k = p->place - m->N[INPUTS_NOW];
    double time = m->R[k >= 0 && k < m->N[N_INPUTS] ? NOW : NEXT];
    return fail(m, "time %.9g s: %s is %g; %s", time, name, m->R[p->place], rule);
}

Status set_experiment(Instance *m, double start, bool stop_defined, double stop) {
    if (!isfinite(start) || (stop_defined && !(stop >= start)))
        return fail(m, "start time %g and stop time %g are not valid", start, stop);
    if (!hold(m, "set start time", INSTANTIATED)) return ERROR;
    m->R[NOW] = m->R[NEXT] = start;
    m->stop_defined = stop_defined, m->stop = stop;
    m->stale = true;
    return release(m, OK);
}

Status enter_initialization(Instance *m) {
    if (!allowed(m, "enter initialization mode", INSTANTIATED)) return ERROR;
    m->mode = INITIALIZATION;
    m->stale = true;
    return OK;
}

Status exit_initialization(Instance *m) {
    if (!hold(m, "exit initialization mode", INITIALIZATION)) return ERROR;
    if (run(m, START) != OK) return release(m, ERROR);
    m->mode = STEPPING;
    return release(m, OK);
}

static Status prepare(Instance *m, double time, double length) {
    double now = m->R[NOW], end = time + length;
    if (!(fabs(time - now) <= CLOCK * (1.0 + fabs(now)))) return fail(m, "the step begins at %.9g s, but the time is %.9g s", time, now);
    if (!isfinite(end) || !(length > 0.0)) return fail(m, "a step of %g s cannot be made; it must be above 0", length);
    if (!(end > now)) return fail(m, "a step of %g s is lost in rounding at %.9g s; take a longer one", length, now);
    if (m->stop_defined && end > m->stop + CLOCK * (1.0 + fabs(m->stop)))
        return fail(m, "the step ends at %.9g s, after the stop time %.9g s", end, m->stop);
    if (!(end - now <= m->R[LONGEST]))
        return fail(m, "the step from %.9g s to %.9g s is longer than %g s, the longest that this FMU takes; divide it", now, end, m->R[LONGEST]);
    m->R[NEXT] = end;
    const int64_t *N = m->N;
    bool reached = timing(m) == REACHED;
    for (int64_t k = 0; k < N[N_INPUTS]; k++) {
        double *slope = &m->R[N[INPUT_SLOPES] + k], given = m->R[N[INPUTS] + k];
        m->R[N[INPUTS_NOW] + k] = reached ? m->R[N[INPUTS_NEXT] + k] : given;
        m->R[N[INPUTS_NEXT] + k] = reached ? given : given + *slope * length;
        *slope = 0.0;
    }
    return OK;
}

Status prepare_step(Instance *m, double time, double length) {
    return hold(m, "do step", STEPPING) ? release(m, prepare(m, time, length)) : ERROR;
}

Status finish_step(Instance *m) {
    if (!hold(m, "do step", STEPPING)) return ERROR;
    if (run(m, STEP) != OK) return release(m, ERROR);
    m->R[NOW] = m->R[NEXT];
    m->N[CHANGED] = 0;
    return release(m, OK);
}

/* States ---------------------------------------------------------------------------------------------------------- */

/* What hosts are given for a state is the address of a ticket. It may be read at any time, and it is given out again only
   after all others: a host's error, a state that has been freed, that of another instance, or a state in the place of the
   address of one, is found without following any address of the host's. */
typedef struct { _Atomic(Instance *) owner; State *state; } Ticket;
enum { FEWEST_TICKETS = 4096, MOST_TICKETS = 1 << 18 };
static Ticket tickets[MOST_TICKETS];
static atomic_size_t next_ticket, n_states;

static const char NOT_OURS[] = "this is not a state of this instance, or it has been freed";
static const char NO_ADDRESS[] = "a state is given where the address of the host's variable for it is due";

static bool is_ticket(const void *handle) {
    return (uintptr_t)handle >= (uintptr_t)tickets && (uintptr_t)handle < (uintptr_t)tickets + sizeof tickets;
}

/* The state of an instance that a host means; NULL where it is none. */
static State *state_of(Instance *m, const void *handle) {
    size_t at = (uintptr_t)handle - (uintptr_t)tickets;
    if (!is_ticket(handle) || at % sizeof *tickets != 0) return NULL;
    Ticket *ticket = &tickets[at / sizeof *tickets];
    return atomic_load(&ticket->owner) == m ? ticket->state : NULL;
}

/* A ticket for a state; NULL where all are in use. */
static Ticket *take_ticket(Instance *m, State *state) {
    size_t most = FEWEST_TICKETS, used = atomic_fetch_add(&n_states, 1) + 1;
    while (most < MOST_TICKETS && 2 * used > most) most *= 2;
    for (size_t tried = 0; tried < most; tried++) {
        Ticket *ticket = &tickets[atomic_fetch_add(&next_ticket, 1) % most];
        Instance *nobody = NULL;
        if (!atomic_compare_exchange_strong(&ticket->owner, &nobody, m)) continue;
        ticket->state = state;
        return ticket;
    }
    atomic_fetch_sub(&n_states, 1);
    return NULL;
}

/* A new state of an instance, whose contents are not set; NULL where out of memory. */
static State *new_state(Instance *m) {
    State *state = malloc(sizeof *state + 8 * (size_t)m->image->n_kept);
    if (!state) return NULL;
    state->own = calloc((size_t)m->image->n_tables + 1, sizeof *state->own);
    state->handle = state->own ? take_ticket(m, state) : NULL;
    if (!state->handle) return free(state->own), free(state), NULL;
    state->before = NULL, state->after = m->states;
    if (m->states) m->states->before = state;
    return m->states = state;
}

static void drop_state(Instance *m, State *state) {
    Ticket *ticket = state->handle;
    *(state->before ? &state->before->after : &m->states) = state->after;
    if (state->after) state->after->before = state->before;
    drop_tables(m->image, state->own);
    free(state->own), free(state);
    ticket->state = NULL;
    atomic_store(&ticket->owner, NULL);
    atomic_fetch_sub(&n_states, 1);
}

Status get_state(Instance *m, void **handle) {
    if (!allowed_between(m, "get state")) return ERROR;
    if (!handle) return refuse(m, "get state", "no pointer to it is given");
    if (is_ticket(handle)) return refuse(m, "get state", NO_ADDRESS);
    State *state = *handle ? state_of(m, *handle) : new_state(m);
    if (!state) return refuse(m, "get state", *handle ? NOT_OURS : "out of memory");
    state->mode = m->mode, state->stop_defined = m->stop_defined, state->stop = m->stop, state->stale = m->stale;
    share_tables(m->image, state->own, m->own);
    Workspace *w = own_workspace(m);
    if (w) {
        copy_away(m->image, w, state->kept);
        take_lock();
        w->busy = false;
        drop_lock();
    } else {
        memcpy(state->kept, m->kept, 8 * (size_t)m->image->n_kept);
    }
    *handle = state->handle;
    return OK;
}

Status set_state(Instance *m, void *handle) {
    if (!allowed_between(m, "set state")) return ERROR;
    const State *state = state_of(m, handle);
    if (!state) return refuse(m, "set state", NOT_OURS);
    leave_workspace(m);
    memcpy(m->kept, state->kept, 8 * (size_t)m->image->n_kept);
    share_tables(m->image, m->own, state->own);
    m->mode = (Mode)state->mode, m->stop_defined = state->stop_defined != 0, m->stop = state->stop, m->stale = state->stale != 0;
    return OK;
}

Status free_state(Instance *m, void **handle) {
    if (!allowed(m, "free state", ANY)) return ERROR;
    if (!handle) return OK;
    if (is_ticket(handle)) return refuse(m, "free state", NO_ADDRESS);
    if (!*handle) return OK;
    State *state = state_of(m, *handle);
    if (!state) return refuse(m, "free state", NOT_OURS);
    drop_state(m, state);
    *handle = NULL;
    return OK;
}

/* A serialised state: a head, the kept words, then each table that was set: a head, its numbers, and its path filled up with
   zeros to whole words. */
typedef struct {
    uint64_t kind, sum;
    int64_t bytes, n_kept, n_tables, mode, stop_defined, stale;
    double stop;
    char token[64];
} StateHead;
typedef struct { int64_t table, is_file, count, path_words; } TableHead;

static size_t path_words(const Table *table) { return (strlen(table->path) + 8) / 8; }

static size_t table_bytes(const Table *table) { return sizeof(TableHead) + 8 * ((size_t)table->count + path_words(table)); }

static size_t size_of(const Image *im, const State *state) {
    size_t size = sizeof(StateHead) + 8 * (size_t)im->n_kept;
    for (int64_t k = 0; k < im->n_tables; k++) {
        if (state->own[k].array) size += table_bytes(state->own[k].array);
        if (state->own[k].file) size += table_bytes(state->own[k].file);
    }
    return size;
}

static char *put_table(char *at, int64_t table, bool is_file, const Table *own) {
    TableHead head = {table, is_file, own->count, (int64_t)path_words(own)};
    memcpy(at, &head, sizeof head), at += sizeof head;
    memcpy(at, own->values, 8 * (size_t)own->count), at += 8 * (size_t)own->count;
    memset(at, 0, 8 * (size_t)head.path_words);
    memcpy(at, own->path, strlen(own->path));
    return at + 8 * head.path_words;
}

Status state_size(Instance *m, void *handle, size_t *size) {
    if (!allowed(m, "size of state", ANY)) return ERROR;
    const State *state = state_of(m, handle);
    if (!state) return refuse(m, "size of state", NOT_OURS);
    if (!size) return refuse(m, "size of state", "no pointer to it is given");
    *size = size_of(m->image, state);
    return OK;
}

Status serialize(Instance *m, void *handle, void *bytes, size_t size) {
    if (!allowed(m, "serialize state", ANY)) return ERROR;
    const State *state = state_of(m, handle);
    if (!state) return refuse(m, "serialize state", NOT_OURS);
    if (!bytes) return refuse(m, "serialize state", "no array is given");
    const Image *im = m->image;
    size_t needed = size_of(im, state);
    if (size < needed) return refuse(m, "serialize state", "does not fit");
    StateHead head = {.kind = STATE, .bytes = (int64_t)needed, .n_kept = im->n_kept, .mode = state->mode,
                      .stop_defined = state->stop_defined, .stale = state->stale, .stop = state->stop};
    strncpy(head.token, im->text + im->token, sizeof head.token - 1);
    char *at = (char *)bytes + sizeof head;
    memcpy(at, state->kept, 8 * (size_t)im->n_kept), at += 8 * im->n_kept;
    for (int64_t k = 0; k < im->n_tables; k++) {
        if (state->own[k].array) at = put_table(at, k, false, state->own[k].array), head.n_tables++;
        if (state->own[k].file) at = put_table(at, k, true, state->own[k].file), head.n_tables++;
    }
    memcpy(bytes, &head, sizeof head);
    head.sum = checksum(bytes, needed);
    memcpy(bytes, &head, sizeof head);
    return OK;
}

/* Read a table of a serialised state; how many bytes it takes, 0 where it is not valid or there is no memory. */
static size_t take_table(const Image *im, Own *own, const char *at, size_t left) {
    TableHead head;
    if (left < sizeof head) return 0;
    memcpy(&head, at, sizeof head);
    int64_t words = (int64_t)((left - sizeof head) / 8);
    if (head.table < 0 || head.table >= im->n_tables || head.is_file < 0 || head.is_file > 1 || head.count < 1 || head.count > words ||
        head.path_words < 1 || head.path_words > TEXT_BYTES / 8 || head.path_words > words - head.count) return 0;
    const char *values = at + sizeof head, *path = values + 8 * head.count;
    Table **to = head.is_file ? &own[head.table].file : &own[head.table].array;
    if (*to || path[8 * head.path_words - 1] != 0) return 0;
    Table *table = new_table((const double *)(const void *)values, head.count, path);
    if (!table || table_size(table->values, head.count) != head.count || (!head.is_file && head.count != inside_size(im, head.table)))
        return free(table), 0;
    *to = table;
    return sizeof head + 8 * (size_t)(head.count + head.path_words);
}

static bool is_mode(int64_t mode) {
    return mode == INSTANTIATED || mode == INITIALIZATION || mode == STEPPING || mode == TERMINATED || mode == FAILED;
}

static bool take_state(const Image *im, State *state, const char *bytes, size_t size) {
    StateHead head, plain;
    memcpy(&head, bytes, sizeof head);
    if (head.kind != STATE || head.bytes != (int64_t)size || head.n_kept != im->n_kept || !is_mode(head.mode) ||
        size < sizeof head + 8 * (size_t)im->n_kept || strncmp(head.token, im->text + im->token, sizeof head.token - 1) != 0) return false;
    plain = head, plain.sum = 0;
    /* The sum is over the words with 0 in its own place; each word counts by its place, so that parts add up. */
    if (checksum_from(&plain, sizeof plain, 0) + checksum_from(bytes + sizeof head, size - sizeof head, sizeof head / 8) != head.sum) return false;
    memcpy(state->kept, bytes + sizeof head, 8 * (size_t)im->n_kept);
    state->mode = head.mode, state->stop_defined = head.stop_defined, state->stop = head.stop, state->stale = head.stale;
    size_t at = sizeof head + 8 * (size_t)im->n_kept;
    for (int64_t k = 0; k < head.n_tables; k++) {
        size_t taken = take_table(im, state->own, bytes + at, size - at);
        if (taken == 0) return false;
        at += taken;
    }
    return at == size;
}

Status deserialize(Instance *m, const void *bytes, size_t size, void **handle) {
    if (!allowed(m, "deserialize state", ANY)) return ERROR;
    if (!bytes || !handle || size < sizeof(StateHead)) return refuse(m, "deserialize state", "no state is given");
    if (is_ticket(handle)) return refuse(m, "deserialize state", NO_ADDRESS);
    State *state = new_state(m);
    if (!state) return refuse(m, "deserialize state", "out of memory");
    if (!take_state(m->image, state, bytes, size)) {
        drop_state(m, state);
        return refuse(m, "deserialize state", "is damaged, or of another model");
    }
    *handle = state->handle;
    return OK;
}
