#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

/* A Peltier plate on a sink that stays at one temperature, for model exchange (FMI 2). */

enum { PWM, PLATE, RATE, CELSIUS, FIRST };
static const double defaults[] = { @values@ };
enum { @names@, COUNT };
typedef struct { double p[COUNT]; double pwm, plate; } Plate;
#define SELF ((Plate *)c)

static double wanted(Plate *m) {
  double bridge = m->p[supply] * m->pwm / 255.0;
  return (-bridge - m->p[seebeck] * (m->p[ambient] - m->plate)) / (m->p[resistance] + m->p[bridge_resistance]);
}

static double rate(Plate *m) {
  double most = m->p[current_limit], current = wanted(m);
  if (current > most) current = most;
  if (current < -most) current = -most;
  double drawn = m->p[seebeck] * m->plate * current - current * current * m->p[resistance] / 2
               + m->p[conductance] * (m->plate - m->p[ambient]);
  return -drawn / m->p[heat_capacity];
}

static void start(Plate *m) { memcpy(m->p, defaults, sizeof defaults); m->pwm = 0; m->plate = 298.15; }

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean a, size_t b, const fmi2String d[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f,
                              fmi2Boolean v, fmi2Boolean l) {
  if (strcmp(g, "{held-sink}") != 0) return NULL;
  Plate *m = calloc(1, sizeof *m); start(m); return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
{ return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { start(SELF); return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == PWM) value[i] = SELF->pwm;
    else if (vr[i] == PLATE) value[i] = SELF->plate;
    else if (vr[i] == RATE) value[i] = rate(SELF);
    else if (vr[i] == CELSIUS) value[i] = SELF->plate - 273.15;
    else if (vr[i] < FIRST + COUNT) value[i] = SELF->p[vr[i] - FIRST];
    else return fmi2Error;
  }
  return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == PWM) SELF->pwm = value[i];
    else if (vr[i] == PLATE) SELF->plate = value[i];
    else if (vr[i] >= FIRST && vr[i] < FIRST + COUNT) SELF->p[vr[i] - FIRST] = value[i];
    else return fmi2Error;
  }
  return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { SELF->plate = x[0]; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = SELF->plate; return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { dx[0] = rate(SELF); return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  if (n > 0) z[0] = SELF->p[current_limit] - wanted(SELF);
  if (n > 1) z[1] = SELF->p[current_limit] + wanted(SELF);
  return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = 300; return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) { memset(info, 0, sizeof *info); return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *enter, fmi2Boolean *end) {
  *enter = fmi2False; *end = fmi2False; return fmi2OK;
}
