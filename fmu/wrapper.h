/* An FMU around a function of arrays: what FMI 2 (fmi2.c) and FMI 3 (fmi3.c) share; it holds no physics.

   A model is an image in resources/model.bin (image.c) and a function of its arrays; the function and the first entries of
   the arrays are described in sim_heating/simulation/fmu_export/parts/library.py. */

#ifndef wrapper_h
#define wrapper_h

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* Compiled functions of a model for one kind of processor; functions.c, written by sim_heating/simulation/fmu_export/parts/library.py, lists them. */
typedef int64_t (*Function)(double *R, int64_t *N, int64_t *called, double *T);
typedef struct { Function move; int64_t *called; } Model;
extern const Model models[];
extern const int n_models;

enum { NOW, NEXT, LONGEST };                                                         /* of R */
enum { INPUTS, N_INPUTS, INPUTS_NOW, INPUTS_NEXT, INPUT_SLOPES, CHANGED, TIMING, MODE, TIMING_INTEGER };  /* of N */
enum { HELD = 1, REACHED = 2 };                                                     /* values of N[TIMING] */
enum { STEP, START, RESUME };                                                       /* values of N[MODE] */
enum { GOOD = -1 };

enum { KIND_NUMBER, KIND_INTEGER, KIND_TABLE, KIND_SHARED };
enum { ROLE_INDEPENDENT, ROLE_INPUT, ROLE_TUNABLE, ROLE_FIXED, ROLE_OUTPUT, ROLE_CONSTANT };
enum { TEXT_BYTES = 1024 };                                   /* of a table's path, with the 0 that ends it */

typedef struct { int64_t kind, role, place, count, name; double lower, upper; } Variable;
typedef struct { int64_t name, rule, place; } Problem;
typedef struct { int64_t place, count; } Run;

struct Instance;

/* Arrays R and N that instances of one image work in, one at a time. All but the kept runs is constant, or is written before
   it is read, or is a cache that says what it holds. */
typedef struct Workspace {
    struct Workspace *next;
    struct Instance *owner;        /* whose state it holds; NULL where nobody's */
    bool busy;                     /* a call is working in it, or its owner's state is being copied away */
    bool resumed;                  /* the model has made good what depends on the kept runs */
    bool spoiled;                  /* a problem may have left numbers in it that are not finite */
    uint64_t turn;                 /* when it was last used */
    double *R;
    int64_t *N;
    void *memory;
} Workspace;

/* resources/model.bin, which all instances of it share. */
typedef struct Image {
    int64_t n_R, n_N, n_T, n_variables, n_problems, n_kept_R, n_kept_N, n_text, token;
    uint64_t sum;
    const Variable *variables;
    const Problem *problems;
    const Run *kept_R, *kept_N;
    const double *R;
    const int64_t *N;
    double *T;
    const char *text;
    void *memory;
    int64_t n_kept;                /* words that the kept runs take */
    uint64_t *initial;             /* the state before a host has set anything */
    int64_t n_tables, *tables;     /* variables that are paths of tables */
    int64_t *table_of;             /* for each variable the last table before it */
    struct Image *next;
    int64_t users;
    Workspace *workspaces;
} Image;

/* The image in resources/model.bin, shared with the instances that have it already; NULL, with the reason in `why`, where it
   cannot be read. */
Image *share_image(const char *folder, char *why, size_t size);
void drop_image(Image *image);

/* A lock for what instances share, held for a few instructions at a time. */
void take_lock(void);
void drop_lock(void);

/* Sum over all words of 8 bytes, each mixed with its place so that every bit affects every bit: one changed or moved word
   changes the sum; several leave it unchanged with a probability of 2^-64. */
uint64_t checksum(const void *bytes, size_t size);

/* The part of such a sum that comes from words after `before` others. */
uint64_t checksum_from(const void *bytes, size_t size, size_t before);

/* A file's whole contents, with a 0 after them; NULL where it cannot be read. The path is UTF-8. */
char *read_file(const char *path, size_t *size);

/* Integers of N for a table: places of the names of its basis, place in T, number of lanes that use it, and the place in N of
   each lane's table. Lanes count tables from the beginning of T. */
enum { TABLE_REFERENCE, TABLE_RECOVERY, TABLE_UNSTATED, TABLE_INSIDE, TABLE_N_LANES, TABLE_LANES };

/* What the ratios of a model are over: its reference heating, the recovery enthalpy that they are reduced with, and the one
   that a file means that states none. */
typedef struct { const char *reference, *recovery, *unstated; } RatioBasis;

/* Nodes and ratios of a heating-ratio table (a contract CSV), packed as the kernel reads it; NULL, with the reason. */
double *read_ratio_table(const char *path, RatioBasis basis, int64_t *count, char *why, size_t size);

/* Number of doubles of a packed table; 0 where its axis lengths are not valid or it has more than `most`. */
int64_t table_size(const double *table, int64_t most);

typedef enum { OK = 0, WARNING = 1, ERROR = 3 } Status;      /* numbers of FMI 2 and of FMI 3 */
typedef enum {
    INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, INTERMEDIATE = 8, TERMINATED = 16, FAILED = 32
} Mode;
enum { ANY = 63, SETTABLE = INSTANTIATED | INITIALIZATION | STEPPING };

/* A ratio table that a host has set, shared by an instance and its states. */
typedef struct { int64_t users, count; const char *path; double values[]; } Table;

/* The tables that a variable's path and array stand for, where they were set; the file is the one in use. */
typedef struct { Table *array, *file; } Own;

/* A copy of an instance that a host has asked for; `handle` is what the host was given. */
typedef struct State {
    struct State *before, *after;
    void *handle;
    int64_t mode, stop_defined, stale;
    double stop;
    Own *own;
    uint64_t kept[];
} State;

typedef struct Instance {
    uint64_t kind;                 /* marks an instance; checked before any other member is read */
    Image *image;
    const Model *model;
    Workspace *workspace;          /* that holds its state; NULL where `kept` does */
    uint64_t *kept;
    double *R;                     /* of the workspace, between hold and release */
    int64_t *N;
    int held;
    Own *own;                      /* of each table */
    State *states;
    Mode mode;
    bool stop_defined, stale, logging;
    double stop;
    void (*report)(struct Instance *, Status, const char *category, const char *message);
    char *name;
    void *environment;
    void *log, *update;            /* the host's callbacks; their types depend on the FMI version */
} Instance;

Instance *new_instance(const char *name, const char *token, const char *folder, void *environment, void *log,
                       void (*report)(Instance *, Status, const char *, const char *));
void free_instance(Instance *instance);

/* True where a call is allowed in the present mode; otherwise it is reported and refused. */
bool allowed(Instance *instance, const char *function, int modes);
/* The same, and the instance has a workspace until `release`, which returns the status that it is given. */
bool hold(Instance *instance, const char *function, int modes);
Status release(Instance *instance, Status status);
/* The timing of inputs in force, HELD or REACHED. */
int64_t timing(const Instance *instance);
Status fail(Instance *instance, const char *format, ...);
Status refuse(Instance *instance, const char *function, const char *why);

Status get_numbers(Instance *instance, const uint32_t *refs, size_t n, double *values, size_t n_values);
Status set_numbers(Instance *instance, const uint32_t *refs, size_t n, const double *values, size_t n_values);
Status get_integer(Instance *instance, uint32_t ref, int64_t *value);
Status set_integer(Instance *instance, uint32_t ref, int64_t value);
Status get_text(Instance *instance, uint32_t ref, const char **value);
Status set_text(Instance *instance, uint32_t ref, const char *value);
Status set_slope(Instance *instance, uint32_t ref, double slope);

Status set_experiment(Instance *instance, double start, bool stop_defined, double stop);
Status enter_initialization(Instance *instance);
Status exit_initialization(Instance *instance);
/* Parts of a step; between them FMI 3 asks its host for inputs at the end of the step. */
Status prepare_step(Instance *instance, double time, double length);
Status finish_step(Instance *instance);
Status reset(Instance *instance);

Status get_state(Instance *instance, void **state);
Status set_state(Instance *instance, void *state);
Status free_state(Instance *instance, void **state);
Status state_size(Instance *instance, void *state, size_t *size);
Status serialize(Instance *instance, void *state, void *bytes, size_t size);
Status deserialize(Instance *instance, const void *bytes, size_t size, void **state);

#endif
