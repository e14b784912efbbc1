// Drives the rig's Peltier plate as the host commands, and stops by itself when the host does not.
//
// The protocol and the safety layers are described in docs/rig/firmware.md.

#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "boot.h"
#include "config.h"
#include "current.h"
#include "frame.h"
#include "output.h"
#include "request.h"

static frame::Reader reader;
static uint16_t last_sequence = 0;
static bool greeted = false;  // until the first H there is no sequence to compare with

// Sends a payload, or drops it: a host that stopped reading must never hold up this loop.
static void send(const char *payload) {
  char line[frame::kMaxLine];
  const uint8_t length = frame::seal(payload, line);
  // Interrupts stay off between question and write: the USB interrupt could hand the buffer over and
  // leave none free, and write() would then wait. More than fits, so no full packet needs an empty one.
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    if (Serial.availableForWrite() > length) Serial.write(reinterpret_cast<uint8_t *>(line), length);
  }
}

static void refuse(const Request &request, const char *code) {
  char payload[frame::kMaxPayload + 1];
  if (request.has_sequence) {
    snprintf(payload, sizeof payload, "E %u %s", request.sequence, code);
  } else {
    snprintf(payload, sizeof payload, "E - %s", code);
  }
  send(payload);
}

static void report(const Request &request, uint8_t extra) {
  char payload[frame::kMaxPayload + 1];
  snprintf(payload, sizeof payload, "S %u %lu %d %u %u", request.sequence, millis(), output::applied(),
           current::counts(), output::flags() | extra);
  send(payload);
}

static void greet(const Request &request) {
  output::rest();
  last_sequence = request.sequence;
  greeted = true;
  char payload[frame::kMaxPayload + 1];
  snprintf(payload, sizeof payload, "B %u %s %u %u %u %u", request.sequence, TWINMATCH_FIRMWARE,
           config::kProtocol, boot::reason(), config::kDeadlineMs, boot::count());
  send(payload);
}

// True once for each request that changes something; a repeated one is answered without effect.
static bool is_new(const Request &request) {
  if (greeted && !is_newer(request.sequence, last_sequence)) return false;
  last_sequence = request.sequence;
  greeted = true;
  return true;
}

static void set_pwm(const Request &request) {
  if (output::flags() & output::kTripped) {
    refuse(request, "LATCHED");
  } else if (!is_new(request)) {
    report(request, output::kDuplicate);
  } else if (output::apply(request.pwm)) {
    report(request, 0);
  } else {
    refuse(request, "LATCHED");
  }
}

static void clear(const Request &request) {
  if (!is_new(request)) {
    report(request, output::kDuplicate);
    return;
  }
  output::clear();
  report(request, 0);
}

static void answer(const char *payload) {
  Request request;
  switch (parse(payload, config::kPwmLimit, request)) {
    case Verdict::kSyntax: refuse(request, "SYNTAX"); return;
    case Verdict::kUnknown: refuse(request, "UNKNOWN"); return;
    case Verdict::kRange: refuse(request, "RANGE"); return;
    case Verdict::kOk: break;
  }
  switch (request.verb) {
    case 'H': greet(request); break;
    case 'P': set_pwm(request); break;
    case 'Q': report(request, 0); break;
    case 'C': clear(request); break;
  }
}

static void listen() {
  // At most one line's worth each pass, so that a flood of bytes cannot starve the watchdog.
  for (uint8_t i = 0; i < 64 && Serial.available() > 0; ++i) {
    switch (reader.take(static_cast<char>(Serial.read()))) {
      case frame::Event::kNone: break;
      case frame::Event::kFrame: answer(reader.payload()); break;
      case frame::Event::kDamaged: refuse(Request(), "CRC"); break;
      case frame::Event::kTooLong: refuse(Request(), "TOO_LONG"); break;
    }
  }
}

// The third layer of safety: the watchdog is fed only while this loop and the safety timer both run.
// Opening and closing the port at 1200 baud asks for the boot loader, by way of the core's own watchdog
// setting: then the output trips and the feeding stops, so a new sketch can be loaded.
static void feed_watchdog() {
  static uint8_t last_beat = 0;
  if (Serial.baud() == 1200 && !Serial.dtr()) {
    output::trip();
    return;
  }
  const uint8_t beat = output::heartbeat();
  if (beat == last_beat) return;
  last_beat = beat;
  wdt_reset();
}

void setup() {
  output::begin();
  current::begin();
  Serial.begin(115200);
  wdt_enable(WDTO_500MS);
  set_sleep_mode(SLEEP_MODE_IDLE);
}

void loop() {
  listen();
  current::poll();
  feed_watchdog();
  sleep_mode();  // until the next interrupt, at most 1 ms away
}
