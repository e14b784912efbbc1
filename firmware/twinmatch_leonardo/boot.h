// Why the board started, and how often since it got power.
#ifndef TWINMATCH_BOOT_H
#define TWINMATCH_BOOT_H

#include <stdint.h>

namespace boot {

// The reset flags MCUSR as the sketch found them. The Leonardo's boot loader clears them, so behind it
// this reads 0 and count() is what tells a restart from a power-up.
uint8_t reason();

// Restarts since power-up, 0 to 65535.
uint16_t count();

}  // namespace boot

#endif
