// The driver's pins, and what trips on its own: the host deadline, the driver's fault flag, the budget
// of high drive.
//
// A trip lets go of the PWM pin, holds it low, lowers enable, and stays until clear().
#ifndef TWINMATCH_OUTPUT_H
#define TWINMATCH_OUTPUT_H

#include <stdint.h>

namespace output {

// Bits of the status reply. kTripped stands for any of the reasons below it.
enum Flag : uint8_t {
  kEnabled = 0x01,
  kTripped = 0x02,
  kDeadline = 0x04,   // the host fell silent
  kDriver = 0x08,     // nSF low while enabled
  kReset = 0x10,      // the board started since the last clear
  kDuplicate = 0x20,  // set by the caller: the request was answered before and had no effect now
  kBudget = 0x40,     // high drive for longer than the plant needs
};

void begin();

// Applies a set-point, −255..255, and feeds the deadline. False, and nothing applied, while tripped.
bool apply(int16_t pwm);

// Lets go of the trips. The output is zero and off until the next apply(). A trip of the budget stays while
// more than half of it is spent, and what is spent stays in any case.
void clear();

// Zero and off, without a trip: a new host has to command before anything flows.
void rest();

// Zero and off, latched as if the host had fallen silent.
void trip();

// What the pins do now, −255..255.
int16_t applied();

uint8_t flags();

// Counts milliseconds of the safety timer; the main loop feeds the watchdog only while it moves.
uint8_t heartbeat();

}  // namespace output

#endif
