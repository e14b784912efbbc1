// Frames of the serial line: ':' payload '*' CRC '\n', the CRC as four upper-case hex digits.
//
// No Arduino header here, so the tests compile this file on the host as well.
#ifndef TWINMATCH_FRAME_H
#define TWINMATCH_FRAME_H

#include <stdint.h>

namespace frame {

constexpr uint8_t kMaxPayload = 40;
constexpr uint8_t kTail = 5;                                // '*' and four hex digits
constexpr uint8_t kMaxLine = 1 + kMaxPayload + kTail + 1;  // with ':' and '\n'

// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, no reflection.
uint16_t crc16(const char *bytes, uint8_t length);

// Makes a line of `payload` (a string of at most kMaxPayload characters) in `line` (kMaxLine bytes).
// Returns the number of bytes to send.
uint8_t seal(const char *payload, char *line);

enum class Event : uint8_t { kNone, kFrame, kDamaged, kTooLong };

// Finds frames in a stream of bytes. Whatever stands outside ':' ... '\n' is skipped, and a ':' inside a
// frame begins it anew, so one lost line end costs one frame.
class Reader {
 public:
  Event take(char byte);
  // The payload of the frame just found, ended by a zero byte; valid until the next take().
  const char *payload() const { return buffer_; }

 private:
  Event finish();

  char buffer_[kMaxPayload + kTail + 2];  // room for a '\r' and the closing zero
  uint8_t length_ = 0;
  bool inside_ = false;
  bool overflow_ = false;
};

}  // namespace frame

#endif
