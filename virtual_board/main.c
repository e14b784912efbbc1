// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

// An Arduino Leonardo that runs the rig's firmware image unchanged: its USB serial port is a pseudo-terminal,
// its driver pins and inputs are lines on standard input and output, its time passes as it is told.
//
//   virtual_board [--speed N] IMAGE.elf PORT
//
// With --speed its time passes by itself from the start, N times as fast as the wall clock. It ends with its
// standard input.
//
// Each line on standard input is answered by one on standard output:
//   step <µs>        let time pass         run <speed>   let it pass by itself     pause
//   feedback <mV>    current feedback      fault 0|1     the driver's fault flag
//   plug, unplug     the USB cable         hang          the firmware runs astray  state
// The answer is the state at that moment:
//   state <µs> <restarts> <PWM high> <PWM top> <direction> <enable> <port is there>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "port.h"
#include "usb_host.h"

enum { MILLISECOND = 16000 };

static avr_t *avr;
static struct usb_host usb;
static struct port port = {.master = -1};
static avr_cycle_count_t next_frame = 0;
static bool host_present = false;
static bool fault = false;
static uint32_t restarts = 0;
static double speed = 0;  // 0: time stands still between steps
static FILE *answers;

static uint8_t outgoing[64], incoming[64];
static uint32_t outgoing_count = 0, incoming_count = 0;

static void follow_host(void) {
  const bool present = port_is_open(&port);
  if (present == host_present) return;
  if (present) usb_line_coding(&usb, port_baud(&port));
  if (usb_line_state(&usb, present ? 3 : 0)) host_present = present;
}

static void carry(void) {
  if (port.master < 0) return;
  follow_host();
  if (outgoing_count == 0) outgoing_count = port_read(&port, outgoing, sizeof outgoing);
  if (outgoing_count > 0 && usb_send(&usb, outgoing, outgoing_count)) outgoing_count = 0;
  // Asks the device for more only when the last packet is delivered: a reader who sleeps stops the pipe.
  if (incoming_count == 0) incoming_count = usb_receive(&usb, incoming);
  if (incoming_count > 0) {
    const uint32_t done = host_present ? port_write(&port, incoming, incoming_count) : incoming_count;
    memmove(incoming, incoming + done, incoming_count - done);
    incoming_count -= done;
  }
}

static void millisecond(void) {
  static bool was_up = false;
  switch (usb_frame(&usb)) {
    case USB_APPEARED:
      outgoing_count = incoming_count = 0;
      host_present = false;
      port_appear(&port);
      break;
    case USB_GONE: port_vanish(&port); break;
    case USB_NOTHING: break;
  }
  const bool up = !(avr->data[0xE0] & 1);  // the firmware has attached itself to USB
  if (was_up && !up) ++restarts;
  was_up = up;
  board_fault_flag(avr, fault);
  carry();
  next_frame += MILLISECOND;
  board_run_until(avr, next_frame);
}

static void say_state(void) {
  const struct drive now = board_drive(avr);
  fprintf(answers, "state %llu %u %u %u %d %d %d\n", (unsigned long long)board_time_us(avr), restarts, now.high,
          now.top, now.direction, now.enable, port.master >= 0);
  fflush(answers);
}

static bool obey(char *line) {
  char *word = strtok(line, " \n");
  char *value = strtok(NULL, " \n");
  if (word == NULL) return false;
  if (strcmp(word, "step") == 0 && value != NULL) {
    const avr_cycle_count_t end = next_frame + strtoull(value, NULL, 10) / 1000 * MILLISECOND;
    while (next_frame < end) millisecond();
  } else if (strcmp(word, "run") == 0 && value != NULL) {
    speed = atof(value);
  } else if (strcmp(word, "pause") == 0) {
    speed = 0;
  } else if (strcmp(word, "feedback") == 0 && value != NULL) {
    board_feedback(avr, strtoul(value, NULL, 10));
  } else if (strcmp(word, "fault") == 0 && value != NULL) {
    fault = *value == '1';
  } else if (strcmp(word, "plug") == 0 || strcmp(word, "unplug") == 0) {
    usb_plug(&usb, *word == 'p');
  } else if (strcmp(word, "hang") == 0) {
    return board_hang(avr);
  } else {
    return strcmp(word, "state") == 0;
  }
  return true;
}

static double wall(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + now.tv_nsec * 1e-9;
}

// Runs what is due, but no long stretch at once: time held up by a busy machine is lost, not caught up with,
// or the firmware would take the machine's delays for a silent host.
static void pace(void) {
  static double due = 0;
  const double now = wall(), most = 0.020 / speed + 0.005;
  if (now - due > most) due = now - most;
  while (due <= now) {
    millisecond();
    due += 0.001 / speed;
  }
}

// Milliseconds until there is something to do; −1 for ever, until the next command.
static int patience(void) { return speed > 0 ? 1 : -1; }

int main(int argc, char **argv) {
  if (argc == 5 && strcmp(argv[1], "--speed") == 0) {
    speed = atof(argv[2]);
    argv += 2;
    argc -= 2;
  }
  if (argc != 3 || speed < 0) {
    fprintf(stderr, "usage: virtual_board [--speed N] IMAGE.elf PORT\n");
    return 2;
  }
  answers = fdopen(dup(STDOUT_FILENO), "w");
  dup2(STDERR_FILENO, STDOUT_FILENO);  // libsimavr prints its remarks there
  port.name = argv[2];
  avr = board_start(argv[1]);
  usb_start(&usb, avr);
  say_state();

  char line[128];
  size_t length = 0;
  for (;;) {
    struct pollfd command = {.fd = STDIN_FILENO, .events = POLLIN};
    if (poll(&command, 1, patience()) > 0) {
      if (read(STDIN_FILENO, line + length, 1) != 1) break;  // whoever started us is gone
      if (line[length] == '\n' || length == sizeof line - 2) {
        line[length + 1] = '\0';
        length = 0;
        if (obey(line)) {
          say_state();
        } else {
          fprintf(answers, "error\n");
          fflush(answers);
        }
      } else {
        ++length;
        continue;
      }
    }
    if (speed > 0) pace();
  }
  port_vanish(&port);
  return 0;
}
