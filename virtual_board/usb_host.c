// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

#include "usb_host.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avr_usb.h"
#include "board.h"

enum {
  UDCON_ = 0xE0, UDINT_ = 0xE1, UDIEN_ = 0xE2,
  DETACH_BIT = 0x01, SOF_BIT = 0x04, FRAME_VECTOR = 10,
  BULK_OUT = 2, BULK_IN = 3,
  SETTLE_US = 200,      // time for the device's interrupt to take a packet
  PATIENCE_US = 20000,  // for one stage of a control transfer
};

static void on_attach(struct avr_irq_t *irq, uint32_t value, void *parameter) {
  struct usb_host *host = parameter;
  host->attached = true;
  host->since = host->avr->cycle;
}

void usb_start(struct usb_host *host, avr_t *avr) {
  memset(host, 0, sizeof *host);
  host->avr = avr;
  host->plugged = true;
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_USB_GETIRQ(), USB_IRQ_ATTACH), on_attach, host);
  for (int i = 0; i < avr->interrupts.vector_count; ++i) {
    if (avr->interrupts.vector[i]->vector == FRAME_VECTOR) host->frame_vector = avr->interrupts.vector[i];
  }
  if (host->frame_vector == NULL) {
    fprintf(stderr, "virtual_board: this libsimavr has no USB interrupt\n");
    exit(2);
  }
}

static int transfer(struct usb_host *host, uint32_t kind, uint8_t pipe, uint8_t *bytes, uint32_t *count) {
  struct avr_io_usb packet = {.pipe = pipe, .sz = *count, .buf = bytes};
  const int result = avr_ioctl(host->avr, kind, &packet);
  *count = packet.sz;
  return result;
}

// Repeats a stage until the device takes part in it, letting the processor run in between.
static bool stage(struct usb_host *host, uint32_t kind, uint8_t *bytes, uint32_t *count) {
  const uint32_t wanted = *count;
  for (uint32_t waited = 0; waited < PATIENCE_US; waited += SETTLE_US) {
    board_run(host->avr, SETTLE_US);
    *count = wanted;
    const int result = transfer(host, kind, 0, bytes, count);
    if (result == AVR_IOCTL_USB_OK) return true;
    if (result != AVR_IOCTL_USB_NAK) return false;
  }
  return false;
}

static bool control(struct usb_host *host, uint8_t type, uint8_t request, uint16_t value, uint8_t *data,
                    uint16_t length) {
  uint8_t setup[8] = {type, request, value & 0xFF, value >> 8, 0, 0, length & 0xFF, length >> 8};
  uint32_t count = sizeof setup;
  if (transfer(host, AVR_IOCTL_USB_SETUP, 0, setup, &count) != AVR_IOCTL_USB_OK) return false;
  uint8_t packet[64];
  if (type & 0x80) {  // data towards us; the device needs no status stage in this simulator
    count = sizeof packet;
    if (!stage(host, AVR_IOCTL_USB_READ, packet, &count) || count < length) return false;
    memcpy(data, packet, length);
    return true;
  }
  if (length > 0) {
    count = length;
    if (!stage(host, AVR_IOCTL_USB_WRITE, data, &count)) return false;
  }
  count = sizeof packet;
  return stage(host, AVR_IOCTL_USB_READ, packet, &count);
}

static bool enumerate(struct usb_host *host) {
  avr_ioctl(host->avr, AVR_IOCTL_USB_RESET, NULL);
  board_run(host->avr, 2000);
  uint8_t descriptor[18] = {0};
  if (!control(host, 0x80, 6, 0x0100, descriptor, sizeof descriptor)) return false;
  if (descriptor[0] != 18 || descriptor[1] != 1) return false;
  fprintf(stderr, "virtual_board: USB device %02x%02x:%02x%02x\n", descriptor[9], descriptor[8], descriptor[11],
          descriptor[10]);
  return control(host, 0x00, 9, 1, NULL, 0);
}

static void raise_frame(struct usb_host *host) {
  host->avr->data[UDINT_] |= SOF_BIT;
  if (host->avr->data[UDIEN_] & SOF_BIT) avr_raise_interrupt(host->avr, host->frame_vector);
}

enum usb_event usb_frame(struct usb_host *host) {
  const bool detached = host->avr->data[UDCON_] & DETACH_BIT;
  if (host->configured && (detached || host->attached || !host->plugged)) {
    host->configured = false;
    return USB_GONE;
  }
  if (!host->plugged || detached) return USB_NOTHING;
  if (host->attached && host->avr->cycle - host->since > 16 * 5000) {
    host->attached = false;
    host->configured = enumerate(host);
    if (!host->configured) {  // try again, as a hub does
      host->attached = true;
      host->since = host->avr->cycle;
    }
    return host->configured ? USB_APPEARED : USB_NOTHING;
  }
  if (host->configured) raise_frame(host);
  return USB_NOTHING;
}

void usb_plug(struct usb_host *host, bool plugged) {
  if (plugged && !host->plugged) {
    host->attached = true;
    host->since = host->avr->cycle;
  }
  host->plugged = plugged;
}

bool usb_line_coding(struct usb_host *host, uint32_t baud) {
  uint8_t coding[7] = {baud & 0xFF, baud >> 8 & 0xFF, baud >> 16 & 0xFF, baud >> 24, 0, 0, 8};
  return control(host, 0x21, 0x20, 0, coding, sizeof coding);
}

bool usb_line_state(struct usb_host *host, uint8_t state) { return control(host, 0x21, 0x22, state, NULL, 0); }

bool usb_send(struct usb_host *host, const uint8_t *bytes, uint32_t count) {
  uint8_t packet[64];
  memcpy(packet, bytes, count);
  return transfer(host, AVR_IOCTL_USB_WRITE, BULK_OUT, packet, &count) == AVR_IOCTL_USB_OK;
}

uint32_t usb_receive(struct usb_host *host, uint8_t *bytes) {
  uint32_t count = 64;
  return transfer(host, AVR_IOCTL_USB_READ, BULK_IN | 0x80, bytes, &count) == AVR_IOCTL_USB_OK ? count : 0;
}
