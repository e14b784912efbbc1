#include "frame.h"

#include <string.h>

namespace frame {

namespace {

char hex_digit(uint8_t value) { return value < 10 ? '0' + value : 'A' + (value - 10); }

bool is_printable(const char *bytes, uint8_t length) {
  for (uint8_t i = 0; i < length; ++i) {
    if (bytes[i] < ' ' || bytes[i] > '~') return false;
  }
  return true;
}

void put_crc(uint16_t crc, char *out) {
  for (uint8_t i = 0; i < 4; ++i) out[i] = hex_digit((crc >> (12 - 4 * i)) & 0xF);
}

}  // namespace

uint16_t crc16(const char *bytes, uint8_t length) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < length; ++i) {
    crc ^= static_cast<uint16_t>(static_cast<uint8_t>(bytes[i])) << 8;
    for (uint8_t bit = 0; bit < 8; ++bit) {
      crc = (crc & 0x8000) ? static_cast<uint16_t>((crc << 1) ^ 0x1021) : static_cast<uint16_t>(crc << 1);
    }
  }
  return crc;
}

uint8_t seal(const char *payload, char *line) {
  const uint8_t length = static_cast<uint8_t>(strlen(payload));
  line[0] = ':';
  memcpy(line + 1, payload, length);
  line[1 + length] = '*';
  put_crc(crc16(payload, length), line + 2 + length);
  line[length + 1 + kTail] = '\n';
  return length + kTail + 2;
}

Event Reader::take(char byte) {
  if (byte == ':') {
    inside_ = true;
    overflow_ = false;
    length_ = 0;
    return Event::kNone;
  }
  if (!inside_) return Event::kNone;
  if (byte == '\n') {
    inside_ = false;
    return finish();
  }
  if (length_ + 1u >= sizeof buffer_) {
    overflow_ = true;
  } else {
    buffer_[length_++] = byte;
  }
  return Event::kNone;
}

Event Reader::finish() {
  if (overflow_) return Event::kTooLong;
  if (length_ > 0 && buffer_[length_ - 1] == '\r') --length_;  // a serial monitor may send CR LF
  if (length_ <= kTail || buffer_[length_ - kTail] != '*') return Event::kDamaged;
  const uint8_t size = length_ - kTail;
  if (!is_printable(buffer_, size)) return Event::kDamaged;
  if (size > kMaxPayload) return Event::kTooLong;
  char expected[4];
  put_crc(crc16(buffer_, size), expected);
  // As text, so that a lower-case digit is damage too.
  if (memcmp(expected, buffer_ + size + 1, sizeof expected) != 0) return Event::kDamaged;
  buffer_[size] = '\0';
  return Event::kFrame;
}

}  // namespace frame
