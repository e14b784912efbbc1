#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* A Peltier plate on a sink that stays at one temperature, for model exchange and co-simulation (FMI 3). */

enum { PWM, PLATE, RATE, CELSIUS, FIRST };
static const double defaults[] = { @values@ };
enum { @names@, COUNT };
typedef struct { double p[COUNT]; double pwm, plate; } Plate;

static double rate(const Plate *m, double plate) {
  double bridge = m->p[supply] * m->pwm / 255.0, most = m->p[current_limit];
  double current = (-bridge - m->p[seebeck] * (m->p[ambient] - plate))
                 / (m->p[resistance] + m->p[bridge_resistance]);
  if (current > most) current = most;
  if (current < -most) current = -most;
  double drawn = m->p[seebeck] * plate * current - current * current * m->p[resistance] / 2
               + m->p[conductance] * (plate - m->p[ambient]);
  return -drawn / m->p[heat_capacity];
}

static void start(Plate *m) { memcpy(m->p, defaults, sizeof defaults); m->pwm = 0; m->plate = 298.15; }

static Plate *made(const char *token) {
  if (strcmp(token, "{held-sink}") != 0) return NULL;
  Plate *m = calloc(1, sizeof *m); start(m); return m;
}

const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateModelExchange(const char *n, const char *token) { return made(token); }
void *fmi3InstantiateCoSimulation(const char *n, const char *token) { return made(token); }
void fmi3FreeInstance(Plate *m) { free(m); }
int fmi3EnterInitializationMode(Plate *m) { return 0; }
int fmi3ExitInitializationMode(Plate *m) { return 0; }
int fmi3Terminate(Plate *m) { return 0; }
int fmi3Reset(Plate *m) { start(m); return 0; }

int fmi3GetFloat64(Plate *m, const uint32_t vr[], size_t n, double value[], size_t values) {
  if (n != values) return 3;
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == PWM) value[i] = m->pwm;
    else if (vr[i] == PLATE) value[i] = m->plate;
    else if (vr[i] == RATE) value[i] = rate(m, m->plate);
    else if (vr[i] == CELSIUS) value[i] = m->plate - 273.15;
    else if (vr[i] < FIRST + COUNT) value[i] = m->p[vr[i] - FIRST];
    else return 3;
  }
  return 0;
}
int fmi3SetFloat64(Plate *m, const uint32_t vr[], size_t n, const double value[], size_t values) {
  if (n != values) return 3;
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == PWM) m->pwm = value[i];
    else if (vr[i] == PLATE) m->plate = value[i];
    else if (vr[i] >= FIRST && vr[i] < FIRST + COUNT) m->p[vr[i] - FIRST] = value[i];
    else return 3;
  }
  return 0;
}

int fmi3SetTime(Plate *m, double t) { return 0; }
int fmi3SetContinuousStates(Plate *m, const double x[], size_t n) { m->plate = x[0]; return 0; }
int fmi3GetContinuousStates(Plate *m, double x[], size_t n) { x[0] = m->plate; return 0; }
int fmi3GetContinuousStateDerivatives(Plate *m, double dx[], size_t n) { dx[0] = rate(m, m->plate); return 0; }
int fmi3GetNumberOfEventIndicators(Plate *m, size_t *n) { *n = 0; return 0; }
int fmi3GetNumberOfContinuousStates(Plate *m, size_t *n) { *n = 1; return 0; }
int fmi3EnterEventMode(Plate *m) { return 0; }
int fmi3EnterContinuousTimeMode(Plate *m) { return 0; }
int fmi3UpdateDiscreteStates(Plate *m, bool *again, bool *end, bool *nominals, bool *states, bool *timed, double *t) {
  *again = *end = *nominals = *states = *timed = false; *t = 0; return 0;
}
int fmi3CompletedIntegratorStep(Plate *m, bool kept, bool *events, bool *end) { *events = *end = false; return 0; }

int fmi3DoStep(Plate *m, double t, double size, bool kept, bool *event, bool *end, bool *early, double *last) {
  enum { STEPS = 20 };
  double h = size / STEPS;
  for (int i = 0; i < STEPS; i++) {
    double k1 = rate(m, m->plate), k2 = rate(m, m->plate + h / 2 * k1), k3 = rate(m, m->plate + h / 2 * k2);
    m->plate += h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(m, m->plate + h * k3));
  }
  *event = *end = *early = false; *last = t + size;
  return 0;
}
