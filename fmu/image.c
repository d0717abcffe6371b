/* resources/model.bin: a head of MAGIC and int64 counts, then variables, problems, R, N and text; all little-endian, 8
   bytes a number. The last count is the checksum of all words after the head. */

#include "wrapper.h"

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#endif

static const char MAGIC[16] = "sim-heating-fmu2";
enum { COUNTS = 7 };

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
uint64_t checksum(const void *bytes, size_t size) {
    uint64_t sum = 0, word;
    for (size_t k = 0; k < size / sizeof word; k++) {
        memcpy(&word, (const char *)bytes + k * sizeof word, sizeof word);
        word += (k + 1) * 0x9e3779b97f4a7c15u;
        word = (word ^ word >> 30) * 0xbf58476d1ce4e5b9u;
        word = (word ^ word >> 27) * 0x94d049bb133111ebu;
        sum += word ^ word >> 31;
    }
    return sum;
}

/* True where the sections fill the file exactly and every variable, problem and text lies within them. */
static bool whole(const Image *im, size_t size) {
    const int64_t counts[] = {im->n_R, im->n_N, im->n_variables, im->n_problems, im->n_text};
    for (int k = 0; k < 5; k++)
        if (counts[k] < 1 || counts[k] > (int64_t)size) return false;
    size_t need = sizeof MAGIC + COUNTS * sizeof(int64_t) + (size_t)im->n_variables * sizeof(Variable) +
                  (size_t)im->n_problems * sizeof(Problem) + 8 * (size_t)(im->n_R + im->n_N) + (size_t)im->n_text;
    return need == size && im->token >= 0 && im->token < im->n_text;
}

static bool consistent(const Image *im) {
    if (im->text[im->n_text - 1] != 0) return false;
    for (int64_t k = 0; k < im->n_variables; k++) {
        const Variable *v = &im->variables[k];
        int64_t end = v->kind == KIND_NUMBER ? im->n_R : im->n_N;
        if (v->place < 0 || v->count < 1 || v->place > end - v->count || v->name < 0 || v->name >= im->n_text) return false;
    }
    for (int64_t k = 0; k < im->n_problems; k++) {
        const Problem *p = &im->problems[k];
        if (p->place >= im->n_R || p->name >= im->n_text || p->rule >= im->n_text || p->name < 0 || p->rule < 0) return false;
    }
    return true;
}

bool read_image(Image *image, const char *folder, char *why, size_t size) {
    char path[4096];
    size_t length = strlen(folder), bytes = 0;
    bool closed = length > 0 && (folder[length - 1] == '/' || folder[length - 1] == '\\');
    if (snprintf(path, sizeof path, "%s%smodel.bin", folder, closed ? "" : "/") >= (int)sizeof path) {
        snprintf(why, size, "the path of the resources is longer than %d bytes", (int)sizeof path);
        return false;
    }
    char *at = read_file(path, &bytes);
    image->memory = at;
    if (!at) {
        snprintf(why, size, "%.900s cannot be read", path);
        return false;
    }
    int64_t head[COUNTS];
    bool good = bytes >= sizeof MAGIC + sizeof head && memcmp(at, MAGIC, sizeof MAGIC) == 0;
    if (good) {
        memcpy(head, at + sizeof MAGIC, sizeof head);
        image->n_R = head[0], image->n_N = head[1], image->n_variables = head[2];
        image->n_problems = head[3], image->n_text = head[4], image->token = head[5];
        size_t behind = sizeof MAGIC + sizeof head;
        good = whole(image, bytes) && checksum(at + behind, bytes - behind) == (uint64_t)head[6];
    }
    if (good) {
        at += sizeof MAGIC + sizeof head;
        image->variables = (const Variable *)(void *)at, at += (size_t)image->n_variables * sizeof(Variable);
        image->problems = (const Problem *)(void *)at, at += (size_t)image->n_problems * sizeof(Problem);
        image->R = (const double *)(void *)at, at += 8 * (size_t)image->n_R;
        image->N = (const int64_t *)(void *)at, at += 8 * (size_t)image->n_N;
        image->text = at;
        good = consistent(image);
    }
    if (!good) snprintf(why, size, "%.900s is damaged or of another version; export the FMU again", path);
    return good;
}
