// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

#include "board.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avr_adc.h"
#include "avr_extint.h"
#include "avr_ioport.h"
#include "sim_elf.h"

enum {
  FREQUENCY = 16000000,
  FEEDBACK_ADC = 7,
  // Addresses in the data space of the ATmega32U4.
  DDRB_ = 0x24, PORTB_ = 0x25,
  DDRD_ = 0x2A, PORTD_ = 0x2B,
  DDRE_ = 0x2D, PORTE_ = 0x2E,
  TCCR1A_ = 0x80, TCCR1B_ = 0x81, ICR1_ = 0x86, OCR1A_ = 0x88,
  // Arduino pins: 9 = PB5, 4 = PD4, 12 = PD6, 7 = PE6.
  PWM_BIT = 5, ENABLE_BIT = 4, FAULT_BIT = 6, DIRECTION_BIT = 6,
};

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) {}

static void log_to_stderr(avr_t *avr, const int level, const char *format, va_list arguments) {
  if (level <= LOG_ERROR) vfprintf(stderr, format, arguments);
}

static avr_cycle_count_t boundary(avr_t *avr, avr_cycle_count_t when, void *parameter) { return 0; }

avr_t *board_start(const char *image) {
  avr_global_logger_set(log_to_stderr);
  elf_firmware_t firmware = {0};
  if (elf_read_firmware(image, &firmware) != 0) {
    fprintf(stderr, "virtual_board: %s cannot be read as an AVR image\n", image);
    exit(2);
  }
  avr_t *avr = avr_make_mcu_by_name("atmega32u4");
  if (avr == NULL) {
    fprintf(stderr, "virtual_board: this libsimavr has no atmega32u4\n");
    exit(2);
  }
  avr_init(avr);
  avr->frequency = FREQUENCY;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr->sleep = no_sleep;  // the caller decides how fast time passes
  avr_load_firmware(avr, &firmware);
  avr->frequency = FREQUENCY;
  avr->vcc = avr->avcc = avr->aref = 5000;
  // Unused interrupt pins read low here and would otherwise interrupt for ever.
  for (uint8_t i = 0; i < 8; ++i) avr_extint_set_strict_lvl_trig(avr, i, 0);
  return avr;
}

void board_run_until(avr_t *avr, avr_cycle_count_t cycle) {
  // A timer at the end keeps a sleeping processor from being advanced beyond it.
  if (cycle > avr->cycle) avr_cycle_timer_register(avr, cycle - avr->cycle, boundary, NULL);
  while (avr->cycle < cycle) {
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
      fprintf(stderr, "virtual_board: the processor stopped at 0x%04x\n", (unsigned)avr->pc);
      exit(3);
    }
  }
  avr_cycle_timer_cancel(avr, boundary, NULL);
}

void board_run(avr_t *avr, uint32_t us) { board_run_until(avr, avr->cycle + (avr_cycle_count_t)us * 16); }

uint64_t board_time_us(const avr_t *avr) { return avr->cycle / 16; }

static bool pin_is_high(const avr_t *avr, int ddr, int port, int bit) {
  return (avr->data[ddr] >> bit & 1) && (avr->data[port] >> bit & 1);
}

static uint32_t word_at(const avr_t *avr, int address) {
  return avr->data[address] | (uint32_t)avr->data[address + 1] << 8;
}

// libsimavr draws no waveform in the timer's mode 14, so the registers are read instead of the pin.
struct drive board_drive(const avr_t *avr) {
  struct drive now = {
      .direction = pin_is_high(avr, DDRE_, PORTE_, DIRECTION_BIT),
      .enable = pin_is_high(avr, DDRD_, PORTD_, ENABLE_BIT),
  };
  const bool mode14 = (avr->data[TCCR1A_] & 0x03) == 0x02 && (avr->data[TCCR1B_] & 0x18) == 0x18;
  const bool running = (avr->data[TCCR1B_] & 0x07) == 0x01;
  if (mode14 && running) now.top = word_at(avr, ICR1_) + 1;
  if (!(avr->data[DDRB_] >> PWM_BIT & 1)) return now;
  if (!(avr->data[TCCR1A_] & 0x80)) {
    now.high = pin_is_high(avr, DDRB_, PORTB_, PWM_BIT) ? now.top : 0;
  } else {
    now.high = word_at(avr, OCR1A_) + 1;
    if (now.high > now.top) now.high = now.top;
  }
  return now;
}

void board_feedback(avr_t *avr, uint32_t millivolts) {
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + FEEDBACK_ADC), millivolts);
}

void board_fault_flag(avr_t *avr, bool fault) {
  const bool high = !fault && pin_is_high(avr, DDRD_, PORTD_, ENABLE_BIT);
  // Both: the first outlives what the firmware's pull-up would set, the second takes effect now.
  avr_ioport_external_t level = {.name = 'D', .mask = 1 << FAULT_BIT, .value = high << FAULT_BIT};
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &level);
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), FAULT_BIT), high);
}

bool board_hang(avr_t *avr) {
  static const uint8_t cli_and_loop[] = {0xF8, 0x94, 0xFF, 0xCF};  // cli; rjmp .-2
  for (uint32_t at = 0; at + sizeof cli_and_loop <= avr->flashend; at += 2) {
    if (memcmp(avr->flash + at, cli_and_loop, sizeof cli_and_loop) == 0) {
      avr->pc = at;
      avr->state = cpu_Running;
      return true;
    }
  }
  return false;
}
