// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

// As much of a USB host as a CDC serial port needs: enumeration, line state, one bulk pipe each way.
#ifndef TWINMATCH_USB_HOST_H
#define TWINMATCH_USB_HOST_H

#include <stdbool.h>
#include <stdint.h>

#include "sim_avr.h"

struct usb_host {
  avr_t *avr;
  bool plugged;     // the cable is in
  bool attached;    // the device has pulled up its line since we last looked
  bool configured;  // enumerated
  avr_cycle_count_t since;
  struct avr_int_vector_t *frame_vector;
};

enum usb_event { USB_NOTHING, USB_APPEARED, USB_GONE };

void usb_start(struct usb_host *host, avr_t *avr);

// One start of frame, due every millisecond; enumerates a device that has attached, notices one that left.
enum usb_event usb_frame(struct usb_host *host);

void usb_plug(struct usb_host *host, bool plugged);

// CDC: what the port's user sets. Line state bit 0 is DTR, bit 1 RTS.
bool usb_line_coding(struct usb_host *host, uint32_t baud);
bool usb_line_state(struct usb_host *host, uint8_t state);

// Bulk transfer to the device: true when taken, false to try again.
bool usb_send(struct usb_host *host, const uint8_t *bytes, uint32_t count);

// Bulk transfer from the device into 64 bytes; the number that came.
uint32_t usb_receive(struct usb_host *host, uint8_t *bytes);

#endif
