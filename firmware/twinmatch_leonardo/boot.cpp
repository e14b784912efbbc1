#include "boot.h"

#include <avr/io.h>
#include <avr/wdt.h>

namespace boot {

namespace {

constexpr uint16_t kMark = 0x7A3C;

// Not cleared at start, so both survive a reset; after power-up they hold anything but a matching pair.
uint16_t restarts __attribute__((section(".noinit")));
uint16_t guard __attribute__((section(".noinit")));
uint8_t flags __attribute__((section(".noinit")));

}  // namespace

// Runs before main(): after a watchdog reset the watchdog still runs, with its shortest time.
void early() __attribute__((naked, used, section(".init3")));
void early() {
  flags = MCUSR;
  MCUSR = 0;
  wdt_disable();
  restarts = (static_cast<uint16_t>(restarts ^ guard) == kMark) ? restarts + 1 : 0;
  guard = restarts ^ kMark;
}

uint8_t reason() { return flags; }

uint16_t count() { return restarts; }

}  // namespace boot
