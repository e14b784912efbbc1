#include "current.h"

#include <Arduino.h>

#include "config.h"

namespace current {

namespace {

constexpr uint8_t kMean = 16;
uint16_t values[kMean];
uint16_t sum = 0;
uint8_t next = 0;

}  // namespace

void begin() {
  // The core has switched the converter on with its slowest clock. Reference: the 5 V supply.
  ADMUX = _BV(REFS0) | config::kFeedbackChannel;
  ADCSRB = 0;
  ADCSRA |= _BV(ADSC);
}

void poll() {
  if (ADCSRA & _BV(ADSC)) return;
  sum -= values[next];
  values[next] = ADC;
  sum += values[next];
  next = (next + 1) % kMean;
  ADCSRA |= _BV(ADSC);
}

uint16_t counts() { return (sum + kMean / 2) / kMean; }

}  // namespace current
