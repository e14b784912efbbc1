// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

// A pseudo-terminal under a name of its own, which comes and goes as a USB serial port does.
#ifndef TWINMATCH_PORT_H
#define TWINMATCH_PORT_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

struct port {
  const char *name;
  int master;  // −1 while there is no port
};

void port_appear(struct port *port);
void port_vanish(struct port *port);

// True while some program holds the port open.
bool port_is_open(const struct port *port);

uint32_t port_baud(const struct port *port);

// Up to `size` bytes that were written to the port; 0 when there are none.
uint32_t port_read(const struct port *port, uint8_t *bytes, uint32_t size);

// As many of `count` bytes as the reader has room for.
uint32_t port_write(const struct port *port, const uint8_t *bytes, uint32_t count);

#endif
