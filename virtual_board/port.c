// SPDX-License-Identifier: GPL-3.0-or-later
//
// This file is part of the virtual board of twinmatch. It is a program of its own, used for tests and for the
// rig without the rig. Because it is built with libsimavr it is free software under the GNU General Public
// License, version 3 or later, unlike the rest of the project; it comes WITHOUT ANY WARRANTY.

#include "port.h"

#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

void port_appear(struct port *port) {
  int slave;
  char path[64];
  struct termios raw;
  if (openpty(&port->master, &slave, path, NULL, NULL) != 0) {
    perror("virtual_board: no pseudo-terminal");
    exit(2);
  }
  tcgetattr(slave, &raw);
  cfmakeraw(&raw);
  tcsetattr(slave, TCSANOW, &raw);
  close(slave);  // from here on a hang-up on the master means that nobody has the port open
  fcntl(port->master, F_SETFL, O_NONBLOCK);
  unlink(port->name);
  if (symlink(path, port->name) != 0) {
    perror(port->name);
    exit(2);
  }
}

void port_vanish(struct port *port) {
  if (port->master < 0) return;
  unlink(port->name);
  close(port->master);
  port->master = -1;
}

static short conditions(const struct port *port) {
  struct pollfd look = {.fd = port->master, .events = POLLIN};
  return poll(&look, 1, 0) < 0 ? POLLHUP : look.revents;
}

bool port_is_open(const struct port *port) {
  if (port->master < 0) return false;
  const short now = conditions(port);
  return (now & POLLIN) || !(now & POLLHUP);  // what was written before closing still counts
}

uint32_t port_baud(const struct port *port) {
  struct termios now;
  if (tcgetattr(port->master, &now) != 0) return 115200;
  switch (cfgetospeed(&now)) {
    case B1200: return 1200;
    case B9600: return 9600;
    case B57600: return 57600;
    default: return 115200;
  }
}

uint32_t port_read(const struct port *port, uint8_t *bytes, uint32_t size) {
  const ssize_t count = read(port->master, bytes, size);
  return count > 0 ? (uint32_t)count : 0;
}

uint32_t port_write(const struct port *port, const uint8_t *bytes, uint32_t count) {
  const ssize_t written = write(port->master, bytes, count);
  return written > 0 ? (uint32_t)written : 0;
}
