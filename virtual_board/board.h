// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

// The simulated ATmega32U4 with the wires of the rig: driver pins out, current and fault flag in.
#ifndef TWINMATCH_BOARD_H
#define TWINMATCH_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "sim_avr.h"

struct drive {
  uint32_t high;  // PWM counts the pin is high in each period
  uint32_t top;   // PWM counts of a period; 0 while timer 1 makes no PWM
  bool direction;
  bool enable;
};

// Loads an image; ends the program if it cannot.
avr_t *board_start(const char *image);

// Runs until `cycle`, to a few cycles.
void board_run_until(avr_t *avr, avr_cycle_count_t cycle);

// Runs `us` microseconds from now.
void board_run(avr_t *avr, uint32_t us);

uint64_t board_time_us(const avr_t *avr);

struct drive board_drive(const avr_t *avr);

// Voltage on the current feedback pin A0.
void board_feedback(avr_t *avr, uint32_t millivolts);

// The driver's flag: low when `fault`, and as in the real chip whenever enable is low.
void board_fault_flag(avr_t *avr, bool fault);

// Sends the processor into the endless loop with interrupts off that ends every avr-gcc image.
bool board_hang(avr_t *avr);

#endif
