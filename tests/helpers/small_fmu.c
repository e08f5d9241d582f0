/* A small FMU, FMI 2.0 or 3.0, for model exchange, or for co-simulation that is stepped if it tells no rates. The header beside it has its sizes and equations. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "equations.h"

#if FMI == 2
#define NAME(f) fmi2##f
typedef int Truth;
#else
#define NAME(f) fmi3##f
typedef _Bool Truth;
#endif
#if defined(_WIN32)
#define OUT __declspec(dllexport)
#else
#define OUT __attribute__((visibility("default")))
#endif

enum { OK = 0, ERROR = 3 };
typedef struct {
    double v[NX + NX + NU + NY + NP + 1]; /* states, rates, inputs, outputs, parameters, time */
    int settled;                          /* what the relation was at the last event */
    int co;                               /* an instance for co-simulation */
    int stepping;                         /* it has left initialisation: nothing but inputs can be set */
} Small;

static void solve(Small *m) {
    double *v = m->v;
    EQUATIONS
}
static void begin(Small *m) {
    const double start[] = START;
    memcpy(m->v, start, sizeof m->v);
    m->settled = m->stepping = 0;
}
static void *make(const char *token, int co) {
    Small *m = strcmp(token, TOKEN) ? NULL : malloc(sizeof *m);
    if (!m) return NULL;
    begin(m);
    m->co = co;
    return m;
}
static const int settable[] = SETTABLE;
static int set(Small *m, const unsigned *r, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= NX + NX + NU + NY + NP) return ERROR;
        if (m->stepping && (r[i] < NX || r[i] >= NX + NX + NU)) return ERROR;
        if (TELLS || !m->co || r[i] >= NX || settable[r[i]]) m->v[r[i]] = values[i];
    }
    return OK;
}
static int get(Small *m, const unsigned *r, size_t n, double *values) {
    solve(m);
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= NX + NX + NU + NY + NP) return ERROR;
        values[i] = m->v[r[i]];
    }
    return OK;
}
static int update(Small *m, Truth *jumped, Truth *timed) {
    *jumped = JUMPS;
    *timed = TIMETABLE;
    m->settled = RELATION;
    return OK;
}

OUT void NAME(FreeInstance)(Small *m) { free(m); }
OUT int NAME(Reset)(Small *m) { begin(m); return OK; }
OUT int NAME(ExitInitializationMode)(Small *m) {
    m->stepping = m->co;
    return m->co && TELLS ? ERROR : OK;
}
/* Runge-Kutta's steps, two of them */
static int go_on(Small *m, double t, double h) {
    const double share[] = {0.0, 0.5, 0.5, 1.0}, weight[] = {1.0, 2.0, 2.0, 1.0};
    double *v = m->v, x[NX + 1], dx[NX + 1];
    if (!m->stepping || h <= 0.0) return ERROR;
    h /= 2.0;
    for (int k = 0; k < 2; k++) {
        memcpy(x, v, NX * sizeof *x);
        memset(dx, 0, sizeof dx);
        for (int s = 0; s < 4; s++) {
            for (int i = 0; i < NX; i++) v[i] = x[i] + (s ? h * share[s] * v[NX + i] : 0.0);
            v[NX + NX + NU + NY + NP] = t + (k + share[s]) * h;
            solve(m);
            for (int i = 0; i < NX; i++) dx[i] += weight[s] * v[NX + i] / 6.0;
        }
        for (int i = 0; i < NX; i++) v[i] = x[i] + h * dx[i];
    }
    return STATUS;
}
OUT int NAME(EnterEventMode)(Small *m) { (void)m; return OK; }
OUT int NAME(EnterContinuousTimeMode)(Small *m) { (void)m; return OK; }
OUT int NAME(SetTime)(Small *m, double t) { m->v[NX + NX + NU + NY + NP] = t; return OK; }
OUT int NAME(SetContinuousStates)(Small *m, const double *x, size_t n) {
    memcpy(m->v, x, n * sizeof *x);
    return n == NX ? OK : ERROR;
}
OUT int NAME(GetContinuousStates)(Small *m, double *x, size_t n) {
    memcpy(x, m->v, n * sizeof *x);
    return n == NX ? OK : ERROR;
}
#if FMI == 2
typedef struct { Truth needed, terminate, nominals, values, timed; double at; } Event;
OUT void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *where, const void *calls, Truth visible, Truth log) {
    (void)name; (void)where; (void)calls; (void)visible; (void)log;
    return kind == CO ? make(guid, kind) : NULL;
}
OUT int fmi2SetupExperiment(Small *m, Truth d, double tol, double t, Truth s, double end) {
    (void)d; (void)tol; (void)s; (void)end;
    return fmi2SetTime(m, t);
}
OUT int fmi2EnterInitializationMode(Small *m) { (void)m; return OK; }
OUT int fmi2NewDiscreteStates(Small *m, Event *e) { memset(e, 0, sizeof *e); return update(m, &e->values, &e->timed); }
OUT int fmi2SetReal(Small *m, const unsigned *r, size_t n, const double *v) { return set(m, r, n, v); }
OUT int fmi2GetReal(Small *m, const unsigned *r, size_t n, double *v) { return get(m, r, n, v); }
OUT int fmi2DoStep(Small *m, double t, double h, Truth final) { (void)final; return go_on(m, t, h); }
OUT int fmi2GetDerivatives(Small *m, double *dx, size_t n) { solve(m); memcpy(dx, m->v + NX, n * sizeof *dx); return STATUS; }
#else
#if CO
OUT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *where, Truth visible, Truth log, Truth events, Truth early, const unsigned *between, size_t n, void *env, void *say, void *told) {
    (void)name; (void)where; (void)visible; (void)log; (void)events; (void)early; (void)between; (void)env; (void)say;
    return n || told ? NULL : make(token, 1);
}
#else
OUT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *where, Truth visible, Truth log, void *env, void *say) {
    (void)name; (void)where; (void)visible; (void)log; (void)env; (void)say;
    return make(token, 0);
}
#endif
OUT int fmi3EnterInitializationMode(Small *m, Truth d, double tol, double t, Truth s, double end) {
    (void)d; (void)tol; (void)s; (void)end;
    return fmi3SetTime(m, t);
}
OUT int fmi3UpdateDiscreteStates(Small *m, Truth *needed, Truth *terminate, Truth *nominals, Truth *values, Truth *timed, double *at) {
    *needed = *terminate = *nominals = 0;
    *at = 0.0;
    return update(m, values, timed);
}
OUT int fmi3SetFloat64(Small *m, const unsigned *r, size_t n, const double *v, size_t k) { return k == n ? set(m, r, n, v) : ERROR; }
OUT int fmi3GetFloat64(Small *m, const unsigned *r, size_t n, double *v, size_t k) { return k == n ? get(m, r, n, v) : ERROR; }
OUT int fmi3DoStep(Small *m, double t, double h, Truth final, Truth *event, Truth *end, Truth *early, double *last) {
    (void)final;
    *event = *end = *early = 0;
    *last = t + h;
    return go_on(m, t, h);
}
OUT int fmi3GetContinuousStateDerivatives(Small *m, double *dx, size_t n) { solve(m); memcpy(dx, m->v + NX, n * sizeof *dx); return STATUS; }
#endif
