/* An FMU 2.0, for model exchange and for co-simulation, round equations that numba compiled.

   model.h is written beside this file: the sizes NX, NU, NY and NP, the start values of all variables, the states'
   scales, and the token by which the description knows the binary. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "model.h"

enum { OK = 0, ERROR = 3 };
enum { X = 0, DX = NX, U = DX + NX, Y = U + NU, P = Y + NY, ALL = P + NP };
/* Of co-simulation: how near, in states' scales, a step and its halves must come to each other if the host says
   nothing; how many parts may be tried for that; and what will do with more, where the equations jump. */
#define TOLERANCE 1e-7
#define FINEST 1024
#define ROUGH 1e-3
#define MOST 65536

typedef int Truth;
typedef void (*Log)(void *environment, const char *name, int status, const char *category, const char *message, ...);
typedef struct {
    Log log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Calls;
typedef struct { Truth needed, terminate, nominals, values, timed; double at; } Event;
typedef struct {
    double v[ALL]; /* states, their rates, inputs, outputs, parameters */
    double tolerance;
    long parts; /* of the last step of co-simulation */
    Calls calls;
    char *name;
} Machine;

static const double start[ALL] = START;
static const double scale[NX] = SCALE;

/* numba's own way to call: the results' places first, then the arguments. Anything but 0 is an exception. */
typedef int Equation(void **nothing, void **raised, double *x, double *u, double *theta, double *out);
extern Equation twinbench_rates, twinbench_readings;

static int call(Equation *equation, Machine *m, double *x, double *out) {
    void *nothing = NULL, *raised = NULL;
    return equation(&nothing, &raised, x, m->v + U, m->v + P, out) ? ERROR : OK;
}
static int said(const Calls *calls, const char *name, const char *what) {
    if (calls && calls->log) calls->log(calls->environment, name, ERROR, "logStatusError", "%s", what);
    return ERROR;
}
static int fails(Machine *m, const char *what) { return said(&m->calls, m->name, what); }
static int solved(Machine *m, Equation *equation, double *out) {
    return call(equation, m, m->v + X, out) ? fails(m, "the equations raise an exception here") : OK;
}

static void begin(Machine *m) {
    memcpy(m->v, start, sizeof start);
    m->tolerance = TOLERANCE;
    m->parts = 1;
}

/* x after so many seconds in so many Runge-Kutta steps of fourth order, the inputs held. */
static int advanced(Machine *m, double seconds, long parts, double *x) {
    double y[3][NX], k1[NX], k2[NX], k3[NX], k4[NX], h = seconds / (double)parts;
    memcpy(x, m->v + X, NX * sizeof *x);
    for (long part = 0; part < parts; part++) {
        if (call(twinbench_rates, m, x, k1)) return ERROR;
        for (int i = 0; i < NX; i++) y[0][i] = x[i] + 0.5 * h * k1[i];
        if (call(twinbench_rates, m, y[0], k2)) return ERROR;
        for (int i = 0; i < NX; i++) y[1][i] = x[i] + 0.5 * h * k2[i];
        if (call(twinbench_rates, m, y[1], k3)) return ERROR;
        for (int i = 0; i < NX; i++) y[2][i] = x[i] + h * k3[i];
        if (call(twinbench_rates, m, y[2], k4)) return ERROR;
        for (int i = 0; i < NX; i++) x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
    return OK;
}

static int agree(const double *x, const double *y, double within) {
    for (int i = 0; i < NX; i++)
        if (!(fabs(x[i] - y[i]) < within * fmax(scale[i], fabs(y[i])))) return 0; /* so do NaN and infinity */
    return 1;
}

/* Go over a step in parts, and in twice as many, until the two agree. */
static int follow(Machine *m, double seconds) {
    double coarse[NX], fine[NX];
    long parts = m->parts > 1 ? m->parts / 2 : 1;
    int failed = advanced(m, seconds, parts, coarse);
    for (; parts <= MOST; parts *= 2) {
        int failed_too = advanced(m, seconds, 2 * parts, fine);
        if (!failed && !failed_too && agree(coarse, fine, parts < FINEST ? m->tolerance : fmax(m->tolerance, ROUGH))) {
            memcpy(m->v + X, fine, sizeof fine);
            m->parts = parts;
            return OK;
        }
        memcpy(coarse, fine, sizeof fine);
        failed = failed_too;
    }
    return fails(m, "the equations raise an exception, diverge, or are too stiff; take shorter steps");
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int kind, const char *token, const char *where, const Calls *calls,
                      Truth visible, Truth log) {
    (void)kind; (void)where; (void)visible; (void)log;
    if (strcmp(token, TOKEN)) {
        said(calls, name, "the description and the binary are not of one export");
        return NULL;
    }
    Machine *m = calloc(1, sizeof *m);
    if (m) m->name = malloc(strlen(name) + 1);
    if (!m || !m->name) {
        free(m);
        return NULL;
    }
    strcpy(m->name, name);
    if (calls) m->calls = *calls;
    begin(m);
    return m;
}
void fmi2FreeInstance(Machine *m) {
    if (m) free(m->name);
    free(m);
}
int fmi2Reset(Machine *m) { begin(m); return OK; }
int fmi2SetDebugLogging(Machine *m, Truth on, size_t n, const char *const *categories) {
    (void)m; (void)on; (void)n; (void)categories;
    return OK;
}
int fmi2SetupExperiment(Machine *m, Truth given, double tolerance, double from_s, Truth ends, double until_s) {
    (void)from_s; (void)ends; (void)until_s;
    if (given && tolerance > 0.0) m->tolerance = tolerance;
    return OK;
}
int fmi2EnterInitializationMode(Machine *m) { (void)m; return OK; }
int fmi2ExitInitializationMode(Machine *m) { (void)m; return OK; }
int fmi2Terminate(Machine *m) { (void)m; return OK; }

int fmi2GetReal(Machine *m, const unsigned *which, size_t n, double *values) {
    int rates = 0, readings = 0;
    for (size_t i = 0; i < n; i++) {
        if (which[i] >= ALL) return fails(m, "there is no variable of this reference");
        rates |= which[i] >= DX && which[i] < U;
        readings |= which[i] >= Y && which[i] < P;
    }
    if (rates && solved(m, twinbench_rates, m->v + DX)) return ERROR;
    if (readings && solved(m, twinbench_readings, m->v + Y)) return ERROR;
    for (size_t i = 0; i < n; i++) values[i] = m->v[which[i]];
    return OK;
}
int fmi2SetReal(Machine *m, const unsigned *which, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (which[i] >= ALL || (which[i] >= DX && which[i] < U) || (which[i] >= Y && which[i] < P))
            return fails(m, "only states, inputs and parameters can be set");
        m->v[which[i]] = values[i];
    }
    return OK;
}

/* Model exchange. There are no events. */
int fmi2EnterEventMode(Machine *m) { (void)m; return OK; }
int fmi2EnterContinuousTimeMode(Machine *m) { (void)m; return OK; }
int fmi2NewDiscreteStates(Machine *m, Event *event) { (void)m; memset(event, 0, sizeof *event); return OK; }
int fmi2CompletedIntegratorStep(Machine *m, Truth keeps, Truth *event, Truth *terminate) {
    (void)m; (void)keeps;
    *event = *terminate = 0;
    return OK;
}
int fmi2SetTime(Machine *m, double time_s) { (void)m; (void)time_s; return OK; }
int fmi2SetContinuousStates(Machine *m, const double *x, size_t n) {
    if (n != NX) return fails(m, "there are not so many states");
    memcpy(m->v + X, x, n * sizeof *x);
    return OK;
}
int fmi2GetContinuousStates(Machine *m, double *x, size_t n) {
    if (n != NX) return fails(m, "there are not so many states");
    memcpy(x, m->v + X, n * sizeof *x);
    return OK;
}
int fmi2GetDerivatives(Machine *m, double *dx, size_t n) {
    return n == NX ? solved(m, twinbench_rates, dx) : fails(m, "there are not so many states");
}
int fmi2GetNominalsOfContinuousStates(Machine *m, double *x, size_t n) {
    if (n != NX) return fails(m, "there are not so many states");
    memcpy(x, scale, sizeof scale);
    return OK;
}
int fmi2GetEventIndicators(Machine *m, double *z, size_t n) { (void)m; (void)z; return n ? ERROR : OK; }

/* Co-simulation. */
int fmi2DoStep(Machine *m, double time_s, double seconds, Truth keeps) {
    (void)time_s; (void)keeps;
    return seconds > 0.0 ? follow(m, seconds) : seconds == 0.0 ? OK : fails(m, "a step must go forward");
}
int fmi2CancelStep(Machine *m) { (void)m; return ERROR; }

/* What the description does not offer. */
#define NONE(name, kind) \
    int name(Machine *m, const unsigned *which, size_t n, kind *values) { \
        (void)m; (void)which; (void)values; \
        return n ? ERROR : OK; \
    }
NONE(fmi2GetInteger, int)
NONE(fmi2SetInteger, const int)
NONE(fmi2GetBoolean, Truth)
NONE(fmi2SetBoolean, const Truth)
NONE(fmi2GetString, const char *)
NONE(fmi2SetString, const char *const)
#define NOT(name, ...) int name(Machine *m, __VA_ARGS__) { (void)m; return ERROR; }
NOT(fmi2GetFMUstate, void **state)
NOT(fmi2SetFMUstate, void *state)
NOT(fmi2FreeFMUstate, void **state)
NOT(fmi2SerializedFMUstateSize, void *state, size_t *size)
NOT(fmi2SerializeFMUstate, void *state, char *bytes, size_t size)
NOT(fmi2DeSerializeFMUstate, const char *bytes, size_t size, void **state)
NOT(fmi2GetDirectionalDerivative, const unsigned *of, size_t n, const unsigned *by, size_t k, const double *d,
    double *out)
NOT(fmi2SetRealInputDerivatives, const unsigned *which, size_t n, const int *order, const double *values)
NOT(fmi2GetRealOutputDerivatives, const unsigned *which, size_t n, const int *order, double *values)
NOT(fmi2GetStatus, int kind, int *status)
NOT(fmi2GetRealStatus, int kind, double *value)
NOT(fmi2GetIntegerStatus, int kind, int *value)
NOT(fmi2GetBooleanStatus, int kind, Truth *value)
NOT(fmi2GetStringStatus, int kind, const char **value)
