#include "request.h"

namespace {

// Reads " <digits>" without sign or leading zero, up to `largest`; moves `at` behind it.
bool take_number(const char *&at, int32_t largest, int32_t &value) {
  const char *digits = at;
  if (*digits < '0' || *digits > '9') return false;
  if (*digits == '0' && digits[1] >= '0' && digits[1] <= '9') return false;
  value = 0;
  while (*digits >= '0' && *digits <= '9') {
    value = value * 10 + (*digits - '0');
    if (value > largest) return false;
    ++digits;
  }
  at = digits;
  return true;
}

bool take_space(const char *&at) {
  if (*at != ' ') return false;
  ++at;
  return true;
}

Verdict take_pwm(const char *at, int16_t limit, Request &request) {
  if (!take_space(at)) return Verdict::kSyntax;
  const bool negative = *at == '-';
  if (negative) ++at;
  int32_t magnitude = 0;
  if (!take_number(at, 99999, magnitude) || *at != '\0') return Verdict::kSyntax;
  if (negative && magnitude == 0) return Verdict::kSyntax;
  if (magnitude > limit) return Verdict::kRange;
  request.pwm = static_cast<int16_t>(negative ? -magnitude : magnitude);
  return Verdict::kOk;
}

}  // namespace

Verdict parse(const char *payload, int16_t limit, Request &request) {
  request = Request();
  const char *at = payload;
  request.verb = *at;
  if (request.verb == '\0') return Verdict::kSyntax;
  ++at;
  int32_t sequence = 0;
  if (!take_space(at) || !take_number(at, 0xFFFF, sequence)) return Verdict::kSyntax;
  if (*at != '\0' && *at != ' ') return Verdict::kSyntax;
  request.sequence = static_cast<uint16_t>(sequence);
  request.has_sequence = true;
  switch (request.verb) {
    case 'H':
    case 'Q':
    case 'C':
      return *at == '\0' ? Verdict::kOk : Verdict::kSyntax;
    case 'P':
      return take_pwm(at, limit, request);
    default:
      return Verdict::kUnknown;
  }
}
