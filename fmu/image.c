/* resources/model.bin: a head of MAGIC and int64 counts, then variables, problems, kept runs of R and of N, R, N, T and text;
   all little-endian, 8 bytes a number. The last count is the checksum of all words after the head. Images are shared: a
   loaded library holds each of them once. */

#include "wrapper.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#endif

static const char MAGIC[16] = "sim-heating-fmu3";
enum { COUNTS = 10 };
typedef struct { char magic[sizeof MAGIC]; int64_t counts[COUNTS]; } Head;

static Image *images;
static atomic_flag lock = ATOMIC_FLAG_INIT;

void take_lock(void) {
    while (atomic_flag_test_and_set_explicit(&lock, memory_order_acquire)) {}
}

void drop_lock(void) { atomic_flag_clear_explicit(&lock, memory_order_release); }

static FILE *open_file(const char *path) {
#ifdef _WIN32
    wchar_t wide[4096];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 4096)) return NULL;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

char *read_file(const char *path, size_t *size) {
    FILE *file = open_file(path);
    if (!file) return NULL;
    char *bytes = NULL;
    long length = fseek(file, 0, SEEK_END) ? -1 : ftell(file);
    if (length >= 0 && !fseek(file, 0, SEEK_SET)) bytes = malloc((size_t)length + 1);
    if (bytes && fread(bytes, 1, (size_t)length, file) != (size_t)length) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    if (bytes) {
        bytes[length] = 0;
        *size = (size_t)length;
    }
    return bytes;
}

/* The numbers are those of splitmix64 (Steele, Lea and Flood, 2014). */
uint64_t checksum_from(const void *bytes, size_t size, size_t before) {
    uint64_t sum = 0, word;
    for (size_t k = 0; k < size / sizeof word; k++) {
        memcpy(&word, (const char *)bytes + k * sizeof word, sizeof word);
        word += (before + k + 1) * 0x9e3779b97f4a7c15u;
        word = (word ^ word >> 30) * 0xbf58476d1ce4e5b9u;
        word = (word ^ word >> 27) * 0x94d049bb133111ebu;
        sum += word ^ word >> 31;
    }
    return sum;
}

uint64_t checksum(const void *bytes, size_t size) { return checksum_from(bytes, size, 0); }

/* True where the sections fill the file exactly. */
static bool whole(const Image *im, size_t size) {
    const int64_t counts[] = {im->n_R, im->n_N, im->n_T, im->n_variables, im->n_problems, im->n_kept_R, im->n_kept_N, im->n_text};
    for (int k = 0; k < 8; k++)
        if (counts[k] < (k == 2 ? 0 : 1) || counts[k] > (int64_t)size) return false;
    size_t need = sizeof(Head) + (size_t)im->n_variables * sizeof(Variable) + (size_t)im->n_problems * sizeof(Problem) +
                  (size_t)(im->n_kept_R + im->n_kept_N) * sizeof(Run) + 8 * (size_t)(im->n_R + im->n_N + im->n_T) + (size_t)im->n_text;
    return need == size && im->token >= 0 && im->token < im->n_text;
}

static bool within(int64_t place, int64_t count, int64_t end) { return place >= 0 && count >= 1 && count <= end && place <= end - count; }

/* True where the path of a table is followed by the integers of one: names, its place in T and the places of its lanes. */
static bool names_table(const Image *im, const Variable *v) {
    const int64_t *own = im->N + v->place;
    if (v->count < TABLE_LANES || own[TABLE_LANES - 1] != v->count - TABLE_LANES) return false;
    for (int64_t k = 0; k < TABLE_INSIDE; k++)
        if (!within(own[k], 1, im->n_text)) return false;
    for (int64_t k = TABLE_LANES; k < v->count; k++)
        if (!within(own[k], 1, im->n_N)) return false;
    return within(own[TABLE_INSIDE], 1, im->n_T) && table_size(im->T + own[TABLE_INSIDE], im->n_T - own[TABLE_INSIDE]) > 0;
}

/* True where every variable, problem, run and text lies within its array. */
static bool consistent(const Image *im) {
    if (im->text[im->n_text - 1] != 0) return false;
    const Variable *table = NULL;
    for (int64_t k = 0; k < im->n_variables; k++) {
        const Variable *v = &im->variables[k];
        int64_t end = v->kind == KIND_NUMBER ? im->n_R : v->kind == KIND_SHARED ? im->n_T : im->n_N;
        if (!within(v->place, v->count, end) || !within(v->name, 1, im->n_text)) return false;
        if (v->kind == KIND_TABLE && !names_table(im, table = v)) return false;
        if (v->kind == KIND_SHARED) {
            int64_t inside = table ? im->N[table->place + TABLE_INSIDE] : im->n_T;
            if (v->place < inside || !within(v->place - inside, v->count, table_size(im->T + inside, im->n_T - inside))) return false;
        }
    }
    for (int64_t k = 0; k < im->n_problems; k++) {
        const Problem *p = &im->problems[k];
        if (p->place >= im->n_R || !within(p->name, 1, im->n_text) || !within(p->rule, 1, im->n_text)) return false;
    }
    for (int64_t k = 0; k < im->n_kept_R; k++)
        if (!within(im->kept_R[k].place, im->kept_R[k].count, im->n_R)) return false;
    for (int64_t k = 0; k < im->n_kept_N; k++)
        if (!within(im->kept_N[k].place, im->kept_N[k].count, im->n_N)) return false;
    return true;
}

/* What follows from the file: the initial state and the list of tables; false where out of memory. */
static bool derive(Image *im) {
    for (int64_t k = 0; k < im->n_kept_R; k++) im->n_kept += im->kept_R[k].count;
    for (int64_t k = 0; k < im->n_kept_N; k++) im->n_kept += im->kept_N[k].count;
    im->initial = malloc((size_t)im->n_kept * sizeof *im->initial);
    im->tables = malloc((size_t)im->n_variables * sizeof *im->tables);
    im->table_of = malloc((size_t)im->n_variables * sizeof *im->table_of);
    if (!im->initial || !im->tables || !im->table_of) return false;
    for (int64_t k = 0; k < im->n_variables; k++) {
        if (im->variables[k].kind == KIND_TABLE) im->tables[im->n_tables++] = k;
        im->table_of[k] = im->n_tables - 1;
    }
    uint64_t *at = im->initial;
    for (int64_t k = 0; k < im->n_kept_R; at += im->kept_R[k++].count)
        memcpy(at, im->R + im->kept_R[k].place, 8 * (size_t)im->kept_R[k].count);
    for (int64_t k = 0; k < im->n_kept_N; at += im->kept_N[k++].count)
        memcpy(at, im->N + im->kept_N[k].place, 8 * (size_t)im->kept_N[k].count);
    return true;
}

static void free_image(Image *im) {
    for (Workspace *w = im->workspaces, *next; w; w = next) {
        next = w->next;
        free(w->memory), free(w);
    }
    free(im->memory), free(im->initial), free(im->tables), free(im->table_of), free(im);
}

static void take_counts(Image *im, const int64_t n[]) {
    im->n_R = n[0], im->n_N = n[1], im->n_T = n[2], im->n_variables = n[3], im->n_problems = n[4];
    im->n_kept_R = n[5], im->n_kept_N = n[6], im->n_text = n[7], im->token = n[8], im->sum = (uint64_t)n[9];
}

static Image *read_image(const char *path, char *why, size_t size) {
    size_t bytes = 0;
    Head head;
    Image *im = calloc(1, sizeof *im);
    char *at = im ? read_file(path, &bytes) : NULL;
    if (!at) {
        snprintf(why, size, im ? "%.900s cannot be read" : "out of memory for %.900s", path);
        free(im);
        return NULL;
    }
    im->memory = at;
    bool good = bytes >= sizeof head && memcmp(at, MAGIC, sizeof MAGIC) == 0;
    if (good) {
        memcpy(&head, at, sizeof head);
        take_counts(im, head.counts);
        good = whole(im, bytes) && checksum(at + sizeof head, bytes - sizeof head) == im->sum;
    }
    if (good) {
        at += sizeof head;
        im->variables = (const Variable *)(void *)at, at += (size_t)im->n_variables * sizeof(Variable);
        im->problems = (const Problem *)(void *)at, at += (size_t)im->n_problems * sizeof(Problem);
        im->kept_R = (const Run *)(void *)at, at += (size_t)im->n_kept_R * sizeof(Run);
        im->kept_N = (const Run *)(void *)at, at += (size_t)im->n_kept_N * sizeof(Run);
        im->R = (const double *)(void *)at, at += 8 * (size_t)im->n_R;
        im->N = (const int64_t *)(void *)at, at += 8 * (size_t)im->n_N;
        im->T = (double *)(void *)at, at += 8 * (size_t)im->n_T;
        im->text = at;
        good = consistent(im);
    }
    if (good && derive(im)) return im;
    snprintf(why, size, good ? "out of memory for %.900s" : "%.900s is damaged or of another version; export the FMU again", path);
    free_image(im);
    return NULL;
}

/* A loaded image of these counts, checksum included, with one more user. To be called with the lock. */
static Image *loaded(const int64_t counts[]) {
    Image same;
    take_counts(&same, counts);
    for (Image *im = images; im; im = im->next)
        if (im->sum == same.sum && im->n_R == same.n_R && im->n_N == same.n_N && im->n_T == same.n_T && im->n_text == same.n_text &&
            im->n_variables == same.n_variables && im->n_problems == same.n_problems && im->token == same.token)
            return im->users++, im;
    return NULL;
}

Image *share_image(const char *folder, char *why, size_t size) {
    char path[4096];
    size_t length = strlen(folder);
    bool closed = length > 0 && (folder[length - 1] == '/' || folder[length - 1] == '\\');
    if (snprintf(path, sizeof path, "%s%smodel.bin", folder, closed ? "" : "/") >= (int)sizeof path) {
        snprintf(why, size, "the path of the resources is longer than %d bytes", (int)sizeof path);
        return NULL;
    }
    Head head;
    FILE *file = open_file(path);
    bool read = file && fread(&head, 1, sizeof head, file) == sizeof head && memcmp(head.magic, MAGIC, sizeof MAGIC) == 0;
    if (file) fclose(file);
    Image *image = NULL;
    if (read) {
        take_lock();
        image = loaded(head.counts);
        drop_lock();
    }
    if (image) return image;
    Image *own = read_image(path, why, size);
    if (!own) return NULL;
    const int64_t counts[] = {own->n_R, own->n_N, own->n_T, own->n_variables, own->n_problems,
                              own->n_kept_R, own->n_kept_N, own->n_text, own->token, (int64_t)own->sum};
    take_lock();
    image = loaded(counts);                                    /* another thread may have read it meanwhile */
    if (!image) own->next = images, own->users = 1, images = own;
    drop_lock();
    if (!image) return own;
    free_image(own);
    return image;
}

void drop_image(Image *image) {
    if (!image) return;
    take_lock();
    bool last = --image->users == 0;
    for (Image **at = &images; last && *at; at = &(*at)->next)
        if (*at == image) {
            *at = image->next;
            break;
        }
    drop_lock();
    if (last) free_image(image);
}
