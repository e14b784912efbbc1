// The driver's current, from its feedback pin: 525 mV per ampere, so 9.3 mA per count.
#ifndef TWINMATCH_CURRENT_H
#define TWINMATCH_CURRENT_H

#include <stdint.h>

namespace current {

void begin();

// Takes a finished conversion, if there is one, and starts the next. Never waits.
void poll();

// Mean of the last sixteen conversions, 0..1023 counts of 5 V / 1024.
uint16_t counts();

}  // namespace current

#endif
