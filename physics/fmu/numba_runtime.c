/* What code that numba compiled asks of numba's runtime: memory that counts who holds it.

   The layout and the names are numba's (numba/core/runtime/nrt.cpp). Compiled code reads `count` and `data` itself and
   calls NRT_MemInfo_call_dtor where the count comes to nothing. */
#include <stdint.h>
#include <stdlib.h>

typedef void Destroy(void *data, size_t size, void *how);
typedef struct {
    size_t count;
    Destroy *destroy;
    void *how;
    void *data;
    size_t size;
    void *allocator; /* numba's, for memory that is not its own: none */
} Memory;

/* The memory lies behind its own record. */
Memory *NRT_MemInfo_alloc_aligned(size_t size, unsigned align) {
    Memory *made = malloc(sizeof *made + size + align);
    if (made) {
        uintptr_t after = (uintptr_t)(made + 1);
        *made = (Memory){1, NULL, NULL, (void *)(after + (align - after % align) % align), size, NULL};
    }
    return made;
}
Memory *NRT_MemInfo_alloc(size_t size) { return NRT_MemInfo_alloc_aligned(size, sizeof(double)); }

void NRT_MemInfo_call_dtor(Memory *of) {
    if (of->destroy) of->destroy(of->data, of->size, of->how);
    free(of);
}

/* Memory that may grow, as lists need it, lies by itself. `how` destroys what is in it. */
static void destroy_growing(void *data, size_t size, void *how) {
    (void)size;
    if (how) ((void (*)(void *))how)(data);
    free(data);
}
Memory *NRT_MemInfo_new_varsize_dtor(size_t size, void *how) {
    void *data = malloc(size);
    Memory *made = data ? malloc(sizeof *made) : NULL;
    if (made) *made = (Memory){1, destroy_growing, how, data, size, NULL};
    else free(data);
    return made;
}
Memory *NRT_MemInfo_new_varsize(size_t size) { return NRT_MemInfo_new_varsize_dtor(size, NULL); }

static void *resized(Memory *of, void *data, size_t size) {
    if (data) {
        of->data = data;
        of->size = size;
    }
    return data;
}
void *NRT_MemInfo_varsize_alloc(Memory *of, size_t size) { return resized(of, malloc(size), size); }
void *NRT_MemInfo_varsize_realloc(Memory *of, size_t size) { return resized(of, realloc(of->data, size), size); }
void NRT_MemInfo_varsize_free(Memory *of, void *data) {
    free(data);
    if (data == of->data) of->data = NULL;
}
