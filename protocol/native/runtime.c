/* What compiled kernels need at run time, and conversions between Python objects and their arguments.

   numba's helpers raise exceptions and reshape arrays. Its memory management is C++ (numba/core/runtime/nrt.cpp): the
   part that kernels call is repeated here in C, so that a C compiler is enough. Structures have numba's layout. */

#define NUMBA_EXPORT_FUNC(type) __attribute__((visibility("hidden"))) type
#define NUMBA_EXPORT_DATA(type) __attribute__((visibility("hidden"))) type
#define PYCC_COMPILING
#include "_helperlib.c"

#define HIDDEN __attribute__((visibility("hidden")))
#define MAX_DIMENSIONS 4

/* Reference-counted memory of arrays (numba/core/runtime/nrt.h). */
typedef void destructor_t(void *data, size_t size, void *info);
typedef struct {
    size_t references;
    destructor_t *destroy;
    void *info;
    void *data;
    size_t size;
    void *allocator;
} meminfo_t;

/* An array of n dimensions; extents: shape, then strides in bytes. */
#define ARRAY(n) \
    struct { meminfo_t *meminfo; PyObject *parent; int64_t items, item_bytes; void *data; npy_intp extents[2 * (n)]; }
typedef ARRAY(MAX_DIMENSIONS) array_t;

/* An exception (numba/core/callconv.py); if dynamic > 0, `unwrap` returns a tuple of what `rest` has. */
typedef struct {
    const char *pickled;
    int32_t bytes;
    void *rest;
    PyObject *(*unwrap)(void *rest);
    int32_t dynamic;
} exception_t;

HIDDEN void *NRT_Allocate(size_t size) { return malloc(size); }

HIDDEN void NRT_Free(void *data) { free(data); }

static meminfo_t *fill(meminfo_t *info, void *data, size_t size, destructor_t *destroy, void *more)
{
    *info = (meminfo_t){1, destroy, more, data, size, NULL};
    return info;
}

HIDDEN meminfo_t *NRT_MemInfo_alloc_aligned(size_t size, unsigned align)
{
    size_t room = sizeof(meminfo_t) + size + align;
    meminfo_t *info = room < size ? NULL : malloc(room);
    if (info == NULL)
        return NULL;
    uintptr_t data = (uintptr_t)(info + 1);
    return fill(info, (void *)(data + (align - data % align) % align), size, NULL, NULL);
}

HIDDEN meminfo_t *NRT_MemInfo_alloc(size_t size) { return NRT_MemInfo_alloc_aligned(size, sizeof(void *)); }

HIDDEN void NRT_MemInfo_call_dtor(meminfo_t *info)
{
    if (info->destroy)
        info->destroy(info->data, info->size, info->info);
    free(info);
}

static void free_list(void *data, size_t size, void *info)
{
    if (info)
        ((destructor_t *)info)(data, size, NULL);
    free(data);
}

/* Memory of a list, which may grow. */
HIDDEN meminfo_t *NRT_MemInfo_new_varsize_dtor(size_t size, destructor_t *destroy)
{
    void *data = malloc(size);
    meminfo_t *info = data ? malloc(sizeof(meminfo_t)) : NULL;
    if (info == NULL) {
        free(data);
        return NULL;
    }
    return fill(info, data, size, free_list, (void *)destroy);
}

HIDDEN meminfo_t *NRT_MemInfo_new_varsize(size_t size) { return NRT_MemInfo_new_varsize_dtor(size, NULL); }

HIDDEN void *NRT_MemInfo_varsize_realloc(meminfo_t *info, size_t size)
{
    void *data = realloc(info->data, size);
    if (data) {
        info->data = data;
        info->size = size;
    }
    return data;
}

static void release(meminfo_t *info)
{
    if (info && __atomic_sub_fetch(&info->references, 1, __ATOMIC_ACQ_REL) == 0)
        NRT_MemInfo_call_dtor(info);
}

static void release_object(void *data, size_t size, void *object) { Py_DECREF((PyObject *)object); }

static void release_capsule(PyObject *capsule) { release(PyCapsule_GetPointer(capsule, NULL)); }

/* Arguments. Each function returns 0, or -1 if the object does not fit; an exception may be set then. */

static int refuse(const char *kernel, const char *argument, const char *expected, PyObject *given)
{
    if (PyErr_Occurred())
        return -1;
    if (PyArray_Check(given)) {
        PyArrayObject *array = (PyArrayObject *)given;
        PyErr_Format(PyExc_TypeError, "%s(): argument %s must be %s, not a %d-dimensional array of %S%s%s",
                     kernel, argument, expected, PyArray_NDIM(array), PyArray_DESCR(array),
                     PyArray_IS_C_CONTIGUOUS(array) ? "" : ", not contiguous",
                     PyArray_ISWRITEABLE(array) ? "" : ", read-only");
    } else {
        PyErr_Format(PyExc_TypeError, "%s(): argument %s must be %s, not %s", kernel, argument, expected,
                     Py_TYPE(given)->tp_name);
    }
    return -1;
}

static int has_count(const char *kernel, Py_ssize_t given, Py_ssize_t expected)
{
    if (given != expected)
        PyErr_Format(PyExc_TypeError, "%s() takes %zd argument(s), not %zd", kernel, expected, given);
    return given == expected;
}

static int is_number(PyObject *object)
{
    return PyLong_Check(object) || PyFloat_Check(object) || PyArray_IsScalar(object, Bool) ||
           PyArray_IsScalar(object, Integer) || PyArray_IsScalar(object, Floating);
}

/* As numba does, convert any number: digits behind the point are lost. */
static int take_integer(PyObject *object, int64_t *value)
{
    if (!is_number(object))
        return -1;
    PyObject *number = PyArray_IsScalar(object, Bool) ? PyBool_FromLong(PyObject_IsTrue(object)) : PyNumber_Long(object);
    if (number == NULL)
        return -1;
    *value = PyLong_AsLongLong(number);
    Py_DECREF(number);
    return *value == -1 && PyErr_Occurred() ? -1 : 0;
}

static int take_float(PyObject *object, double *value)
{
    if (!is_number(object))
        return -1;
    *value = PyArray_IsScalar(object, Bool) ? PyObject_IsTrue(object) : PyFloat_AsDouble(object);
    return *value == -1.0 && PyErr_Occurred() ? -1 : 0;
}

static int take_boolean(PyObject *object, uint8_t *value)
{
    if (!is_number(object))
        return -1;
    *value = PyObject_IsTrue(object) == 1;
    return 0;
}

/* `shares`: whether the kernel may return the array or a view of it, so that it needs a reference of its own. */
static int take_array(PyObject *object, char kind, int bytes, int dimensions, int writes, int shares, array_t *value)
{
    if (!PyArray_Check(object))
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    if (PyArray_DESCR(array)->kind != kind || PyArray_ITEMSIZE(array) != bytes || PyArray_NDIM(array) != dimensions ||
        !PyArray_ISNOTSWAPPED(array) || !PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISALIGNED(array) ||
        (writes && !PyArray_ISWRITEABLE(array)))
        return -1;
    value->meminfo = NULL;
    if (shares) {
        meminfo_t *info = malloc(sizeof(meminfo_t));
        if (info == NULL) {
            PyErr_NoMemory();
            return -1;
        }
        Py_INCREF(object);
        value->meminfo = fill(info, PyArray_DATA(array), 0, release_object, object);
    }
    value->parent = object;
    value->items = PyArray_SIZE(array);
    value->item_bytes = bytes;
    value->data = PyArray_DATA(array);
    for (int i = 0; i < dimensions; i++) {
        value->extents[i] = PyArray_DIM(array, i);
        value->extents[dimensions + i] = PyArray_STRIDE(array, i);
    }
    return 0;
}

/* Results. */

/* Whether a returned array is an argument, unchanged. */
static int is_parent(array_t *value, int type, int dimensions)
{
    if (value->parent == NULL || !PyArray_Check(value->parent))
        return 0;
    PyArrayObject *array = (PyArrayObject *)value->parent;
    return PyArray_DATA(array) == value->data && PyArray_NDIM(array) == dimensions &&
           PyArray_EquivTypenums(PyArray_TYPE(array), type) &&
           !memcmp(PyArray_DIMS(array), value->extents, dimensions * sizeof(npy_intp)) &&
           !memcmp(PyArray_STRIDES(array), value->extents + dimensions, dimensions * sizeof(npy_intp));
}

/* Return an array as a Python object, which takes over the reference to its memory. */
static PyObject *box_array(void *result, int type, int dimensions, int writable)
{
    array_t *value = result;
    if (is_parent(value, type, dimensions)) {
        Py_INCREF(value->parent);
        release(value->meminfo);
        return value->parent;
    }
    PyObject *array = PyArray_New(&PyArray_Type, dimensions, value->extents, type, value->extents + dimensions,
                                  value->data, 0, writable ? NPY_ARRAY_WRITEABLE : 0, NULL);
    PyObject *owner = array && value->meminfo ? PyCapsule_New(value->meminfo, NULL, release_capsule) : NULL;
    if (owner == NULL)
        release(value->meminfo);
    if (array && value->meminfo && (owner == NULL || PyArray_SetBaseObject((PyArrayObject *)array, owner) < 0)) {
        Py_DECREF(array);
        return NULL;
    }
    return array;
}

/* Return a tuple that takes over the references to its items; NULL if one is NULL. */
static PyObject *box_tuple(int count, PyObject **items)
{
    PyObject *tuple = PyTuple_New(count);
    for (int i = 0; i < count; i++) {
        if (items[i] == NULL)
            Py_CLEAR(tuple);
        if (tuple)
            PyTuple_SET_ITEM(tuple, i, items[i]);
        else
            Py_XDECREF(items[i]);
    }
    return tuple;
}

/* Raise the exception of a kernel that failed. */
static void raise_exception(int status, exception_t *info)
{
    PyObject *parts;
    if (status < 0) {
        if (!PyErr_Occurred())
            PyErr_Format(PyExc_SystemError, "a kernel failed with status %d", status);
        return;
    }
    if (info->dynamic > 0) {
        PyObject *pickled = PyBytes_FromStringAndSize(info->pickled, info->bytes);
        PyObject *given = pickled ? info->unwrap(info->rest) : NULL;
        parts = given ? numba_runtime_build_excinfo_struct(pickled, given) : NULL;
        Py_XDECREF(pickled);
        Py_XDECREF(given);
        free(info);
    } else {
        parts = numba_unpickle(info->pickled, info->bytes, info->rest);
    }
    if (parts)
        numba_do_raise(parts);
}

static PyObject *make_module(struct PyModuleDef *definition, PyMethodDef *methods, const char **digests)
{
    import_array();
    PyObject *module = PyModule_Create(definition);
    for (; module && methods->ml_name; methods++, digests++)
        if (PyModule_AddObject(module, *digests, PyCFunction_New(methods, NULL)) < 0)
            Py_CLEAR(module);
    return module;
}
