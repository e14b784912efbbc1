// What a host may ask: H seq, P seq pwm, Q seq, C seq. Strict: one spelling for each request.
//
// No Arduino header here, so the tests compile this file on the host as well.
#ifndef TWINMATCH_REQUEST_H
#define TWINMATCH_REQUEST_H

#include <stdint.h>

enum class Verdict : uint8_t { kOk, kSyntax, kUnknown, kRange };

struct Request {
  char verb = 0;
  bool has_sequence = false;  // false when the request is too broken to be answered by number
  uint16_t sequence = 0;
  int16_t pwm = 0;
};

// Reads a payload. `limit` is the largest magnitude of a set-point.
Verdict parse(const char *payload, int16_t limit, Request &request);

// True when `sequence` comes after `last`, counting modulo 65536.
inline bool is_newer(uint16_t sequence, uint16_t last) {
  const uint16_t ahead = static_cast<uint16_t>(sequence - last);
  return ahead >= 1 && ahead < 0x8000;
}

#endif
