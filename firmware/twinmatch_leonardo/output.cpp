#include "output.h"

#include <Arduino.h>
#include <util/atomic.h>
#include <util/delay.h>

#include "boot.h"
#include "config.h"

namespace output {

namespace {

volatile uint8_t state = kTripped | kReset;
volatile int16_t level = 0;       // what the pins do, −255..255
volatile uint16_t remaining = 0;  // ms until the deadline
volatile uint8_t settle = 0;      // ms until nSF may be believed
volatile uint8_t low_for = 0;     // ms nSF has been low
volatile uint8_t beats = 0;

// PWM·ms at which the budget is spent. One addition of at most kPwmLimit goes beyond it before a trip stops
// them, so 32 bits are enough for half an hour.
constexpr int32_t kWhole = (config::kPwmLimit - config::kHoldPwm) * 1000L * config::kFullDriveSeconds;
static_assert(kWhole <= INT32_MAX - config::kPwmLimit, "the budget must fit into 32 bits");

// PWM·ms spent. Neither a host nor a restart of the processor gives any back, only rest does.
volatile int32_t spent __attribute__((section(".noinit")));

// Lets go of the compare unit and holds the pin low. Interrupts are off, or this is one.
void pwm_off() {
  TCCR1A &= ~_BV(COM1A1);
  digitalWrite(config::kPwmPin, LOW);
  level = 0;
}

void pwm_on(int16_t pwm) {
  const uint16_t magnitude = pwm < 0 ? -pwm : pwm;
  const uint32_t counts = config::kPwmTop + 1UL;
  // The pin is high for OCR1A + 1 of the counts; rounded to the nearest.
  const uint16_t high = (magnitude * counts + config::kPwmLimit / 2) / config::kPwmLimit;
  OCR1A = high - 1;
  TCCR1A |= _BV(COM1A1);
  level = pwm;
}

void disable() {
  pwm_off();
  digitalWrite(config::kEnablePin, LOW);
  digitalWrite(LED_BUILTIN, LOW);
  state &= ~kEnabled;
}

void enable() {
  if (state & kEnabled) return;
  settle = config::kFaultSettleMs;
  low_for = 0;
  digitalWrite(config::kEnablePin, HIGH);
  digitalWrite(LED_BUILTIN, HIGH);
  state |= kEnabled;
}

void latch(uint8_t reason) {
  disable();
  state |= kTripped | reason;
}

void watch_host() {
  if (remaining != 0 && --remaining == 0) latch(kDeadline);
}

void watch_driver() {
  if (!(state & kEnabled)) return;  // nSF is low whenever enable is
  if (settle != 0) {
    --settle;
  } else if (digitalRead(config::kFaultPin) == HIGH) {
    low_for = 0;
  } else if (++low_for >= config::kFaultDebounceMs) {
    latch(kDriver);
  }
}

void watch_budget() {
  const int16_t magnitude = level < 0 ? -level : level;  // zero while the driver is off
  const int32_t sum = spent + (magnitude - config::kHoldPwm);
  spent = sum > 0 ? sum : 0;
  if (sum > kWhole) latch(kBudget);
}

// Stops the output if its sign is about to change, and turns the direction pin after a pause at zero.
void turn(bool heat) {
  const uint8_t wanted = heat == config::kHeatLevel ? HIGH : LOW;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    if (digitalRead(config::kDirectionPin) == wanted) return;
    pwm_off();
  }
  _delay_ms(config::kReversalMs);
  digitalWrite(config::kDirectionPin, wanted);
}

}  // namespace

void begin() {
  // After power-up the memory holds anything.
  if (boot::count() == 0 || spent < 0 || spent > kWhole) spent = 0;

  digitalWrite(config::kEnablePin, LOW);
  pinMode(config::kEnablePin, OUTPUT);
  digitalWrite(config::kPwmPin, LOW);
  pinMode(config::kPwmPin, OUTPUT);
  digitalWrite(config::kDirectionPin, config::kHeatLevel ? HIGH : LOW);
  pinMode(config::kDirectionPin, OUTPUT);
  pinMode(config::kFaultPin, INPUT_PULLUP);
  pinMode(LED_BUILTIN, OUTPUT);

  TCCR1A = _BV(WGM11);  // mode 14: fast PWM up to ICR1, compare unit not yet on the pin
  TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
  ICR1 = config::kPwmTop;

  TCCR3A = 0;  // timer 3 is the safety clock: clear on compare, 16 MHz / 64 = 250 counts each ms
  TCCR3B = _BV(WGM32) | _BV(CS31) | _BV(CS30);
  OCR3A = F_CPU / 64 / 1000 - 1;
  TIMSK3 = _BV(OCIE3A);
}

bool apply(int16_t pwm) {
  if (state & kTripped) return false;
  if (pwm != 0) turn(pwm > 0);
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    if (state & kTripped) return false;  // the safety timer may have tripped during the pause
    remaining = config::kDeadlineMs;
    enable();
    if (pwm == 0) {
      pwm_off();
    } else {
      pwm_on(pwm);
    }
  }
  return true;
}

void clear() {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    disable();
    remaining = 0;
    state = (state & kBudget) && spent > kWhole / 2 ? kTripped | kBudget : 0;
  }
}

void rest() {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    disable();
    remaining = 0;
  }
}

void trip() {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { latch(kDeadline); }
}

int16_t applied() {
  int16_t now;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = level; }
  return now;
}

uint8_t flags() { return state; }

uint8_t heartbeat() { return beats; }

ISR(TIMER3_COMPA_vect) {
  ++beats;
  watch_host();
  watch_driver();
  watch_budget();
}

}  // namespace output
