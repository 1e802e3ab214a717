// The interface of a unit for co-simulation, FMI 2.0, behind equations of motion and GUID, POINTS, LONGEST_STEP and shown().
// Inputs are held during a step of the co-simulation, which is divided into equal ones of at most the parameter `step`.
#include <stdlib.h>
#include <string.h>

#define STEP (STATES + INPUTS + PARAMETERS)
#define SHOWN (STEP + 1)
#define REALS (SHOWN + POINTS)

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef void fmi2Logger(void *environment, const char *instance, fmi2Status status, const char *category,
                        const char *message, ...);
typedef struct {
    fmi2Logger *logger;
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(void *environment, fmi2Status status);
    void *environment;
} fmi2Callbacks;

// states, inputs, parameters, the step, and motions of points, by value reference
typedef struct {
    double time;
    double real[REALS];
} Values;

typedef struct {
    Values values;
    const fmi2Callbacks *callbacks;
    char name[256];
} Unit;

static fmi2Status failed(const Unit *unit, const char *message)
{
    if (unit && unit->callbacks && unit->callbacks->logger)
        unit->callbacks->logger(unit->callbacks->environment, unit->name, fmi2Error, "error", "%s", message);
    return fmi2Error;
}

static void reset(Values *values)
{
    memset(values, 0, sizeof *values);
    memcpy(values->real, initial, STATES * sizeof(double));
    memcpy(values->real + STATES + INPUTS, parameters, PARAMETERS * sizeof(double));
    values->real[STEP] = LONGEST_STEP;
}

static int finite(const double *values, int count)
{
    for (int k = 0; k < count; k++)
        if (!(fabs(values[k]) <= 1.7976931348623157e308))
            return 0;
    return 1;
}

static void advanced(Values *values, double h)
{
    static const double ahead[] = {0.0, 0.5, 0.5, 1.0}, weight[] = {1.0, 2.0, 2.0, 1.0};
    double *z = values->real, *u = z + STATES, *p = u + INPUTS;
    double rate[STATES] = {0.0}, sum[STATES] = {0.0}, at[STATES];
    for (int stage = 0; stage < 4; stage++) {
        for (int k = 0; k < STATES; k++)
            at[k] = z[k] + ahead[stage] * h * rate[k];
        rhs(values->time + ahead[stage] * h, at, u, p, rate);
        for (int k = 0; k < STATES; k++)
            sum[k] += weight[stage] * rate[k];
    }
    for (int k = 0; k < STATES; k++)
        z[k] += h / 6.0 * sum[k];
}

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED void *fmi2Instantiate(const char *name, fmi2Type type, const char *guid, const char *resources,
                               const fmi2Callbacks *callbacks, int visible, int logging)
{
    (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, GUID) != 0)
        return NULL;
    Unit *unit = calloc(1, sizeof *unit);
    if (!unit)
        return NULL;
    unit->callbacks = callbacks;
    strncpy(unit->name, name ? name : "", sizeof unit->name - 1);
    reset(&unit->values);
    return unit;
}

EXPORTED void fmi2FreeInstance(void *c) { free(c); }

EXPORTED fmi2Status fmi2SetDebugLogging(void *c, int on, size_t count, const char *const categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetupExperiment(void *c, int tolerant, double tolerance, double start, int stops, double stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    ((Unit *)c)->values.time = start;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterInitializationMode(void *c) { return c ? fmi2OK : fmi2Error; }

EXPORTED fmi2Status fmi2ExitInitializationMode(void *c) { return c ? fmi2OK : fmi2Error; }

EXPORTED fmi2Status fmi2Terminate(void *c) { return c ? fmi2OK : fmi2Error; }

EXPORTED fmi2Status fmi2Reset(void *c)
{
    reset(&((Unit *)c)->values);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetReal(void *c, const unsigned int references[], size_t count, double values[])
{
    double *real = ((Unit *)c)->values.real;
    shown(real, real + SHOWN);
    for (size_t k = 0; k < count; k++) {
        if (references[k] >= REALS)
            return failed(c, "there is no variable of this reference");
        values[k] = real[references[k]];
    }
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetReal(void *c, const unsigned int references[], size_t count, const double values[])
{
    for (size_t k = 0; k < count; k++) {
        if (references[k] >= SHOWN)
            return failed(c, "no variable of this reference can be set");
        ((Unit *)c)->values.real[references[k]] = values[k];
    }
    return fmi2OK;
}

EXPORTED fmi2Status fmi2DoStep(void *c, double time, double length, int keep)
{
    Values *values = &((Unit *)c)->values;
    (void)keep;
    const double step = values->real[STEP];
    if (!(step > 0.0) || !(length >= 0.0) || !(length / step < 1e12))
        return failed(c, "the step must be positive, and the time must not go back");
    const double count = length > 0.0 ? ceil(length / step * (1.0 - 1e-12)) : 0.0;
    for (double k = 0.0; k < count; k += 1.0) {
        values->time = time + k * (length / count);
        advanced(values, length / count);
    }
    values->time = time + length;
    if (!finite(values->real, STATES))
        return failed(c, "the motion is no longer finite; try a shorter step");
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetFMUstate(void *c, void **state)
{
    if (!*state && !(*state = malloc(sizeof(Values))))
        return failed(c, "there is no memory left");
    memcpy(*state, &((Unit *)c)->values, sizeof(Values));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetFMUstate(void *c, void *state)
{
    memcpy(&((Unit *)c)->values, state, sizeof(Values));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2FreeFMUstate(void *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(Values);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    if (size < sizeof(Values))
        return failed(c, "the state needs more bytes");
    memcpy(bytes, state, sizeof(Values));
    return fmi2OK;
}

EXPORTED fmi2Status fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    if (size != sizeof(Values))
        return failed(c, "these bytes are no state of this unit");
    if (!*state && !(*state = malloc(sizeof(Values))))
        return failed(c, "there is no memory left");
    memcpy(*state, bytes, sizeof(Values));
    return fmi2OK;
}

// what units may have and this one has not
#define ABSENT(name, type)                                                                            \
    EXPORTED fmi2Status name(void *c, const unsigned int references[], size_t count, type values)      \
    {                                                                                                  \
        (void)references, (void)values;                                                                \
        return count == 0 ? fmi2OK : failed(c, "there are only real variables");                       \
    }

ABSENT(fmi2GetInteger, int *)
ABSENT(fmi2GetBoolean, int *)
ABSENT(fmi2GetString, const char **)
ABSENT(fmi2SetInteger, const int *)
ABSENT(fmi2SetBoolean, const int *)
ABSENT(fmi2SetString, const char *const *)

EXPORTED fmi2Status fmi2SetRealInputDerivatives(void *c, const unsigned int references[], size_t count,
                                                const int orders[], const double values[])
{
    (void)references, (void)orders, (void)values;
    return count == 0 ? fmi2OK : failed(c, "inputs are held during a step");
}

EXPORTED fmi2Status fmi2GetRealOutputDerivatives(void *c, const unsigned int references[], size_t count,
                                                 const int orders[], double values[])
{
    (void)references, (void)orders, (void)values;
    return count == 0 ? fmi2OK : failed(c, "there are no derivatives of outputs");
}

EXPORTED fmi2Status fmi2GetDirectionalDerivative(void *c, const unsigned int unknown[], size_t unknowns,
                                                 const unsigned int known[], size_t knowns, const double by[],
                                                 double derivative[])
{
    (void)unknown, (void)known, (void)knowns, (void)by, (void)derivative;
    return unknowns == 0 ? fmi2OK : failed(c, "there are no directional derivatives");
}

EXPORTED fmi2Status fmi2CancelStep(void *c) { return failed(c, "steps are never pending"); }

#define NO_STATUS(name, type)                                                                          \
    EXPORTED fmi2Status name(void *c, int kind, type value)                                            \
    {                                                                                                  \
        (void)c, (void)kind, (void)value;                                                              \
        return fmi2Discard;                                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status *)
NO_STATUS(fmi2GetIntegerStatus, int *)
NO_STATUS(fmi2GetBooleanStatus, int *)
NO_STATUS(fmi2GetStringStatus, const char **)

EXPORTED fmi2Status fmi2GetRealStatus(void *c, int kind, double *value)
{
    (void)kind;
    *value = ((Unit *)c)->values.time;
    return fmi2OK;
}
