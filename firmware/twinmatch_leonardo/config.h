// Pins, times and limits of the rig's driver board. Everything a rig may need to change is here.
//
// Board: Arduino Leonardo under a Pololu dual MC33926 shield, motor channel 1 to the Peltier plate.
#ifndef TWINMATCH_CONFIG_H
#define TWINMATCH_CONFIG_H

#include <stdint.h>

#define TWINMATCH_FIRMWARE "1.1.0"

namespace config {

constexpr uint8_t kProtocol = 1;  // changes whenever an old host would misread a reply

constexpr uint8_t kEnablePin = 4;      // shield nD2: high drives, low lets the plate coast
constexpr uint8_t kDirectionPin = 7;   // shield M1DIR
constexpr uint8_t kPwmPin = 9;         // shield M1PWM, OC1A of timer 1
constexpr uint8_t kFaultPin = 12;      // shield nSF, low on a driver fault and whenever enable is low
constexpr uint8_t kFeedbackChannel = 7;  // shield M1FB on A0, which is ADC7 of the ATmega32U4

// Level of the direction pin that heats the plate. Swap this, not the wires, if a positive PWM cools.
constexpr bool kHeatLevel = false;

constexpr int16_t kPwmLimit = 255;

// Timer 1 counts 0..kPwmTop at 16 MHz. 799 gives 20 kHz, the fastest the MC33926 allows.
// 1019 gives 15.7 kHz and every one of the 255 steps exactly.
constexpr uint16_t kPwmTop = 799;

// Without a valid new set-point for this long the output trips. Between 500 and 2000 ms.
constexpr uint16_t kDeadlineMs = 1000;

// The budget ends a drive that is high for longer than the plant needs, whatever the host believes: its
// sensor may have drifted or slipped off. Each millisecond |PWM| − kHoldPwm is added, never below zero, and
// beyond what kFullDriveSeconds at ±255 add the output trips. The rig holds 90 °C with 216, so a level below
// 220 may stay for ever. 480 s is 16 800 PWM·s; the recorded hours of the rig reach 7 250, a step from cold
// included. A plate at full drive is at its final temperature after about two minutes, so this limits how
// long it is hot, not how hot it becomes. A plate that needs more than 220 for good needs a higher kHoldPwm.
constexpr int16_t kHoldPwm = 220;
constexpr uint16_t kFullDriveSeconds = 480;

constexpr uint8_t kReversalMs = 2;       // output held at zero before the direction changes
constexpr uint8_t kFaultSettleMs = 10;   // after enable, the driver needs up to 5 ms before nSF is true
constexpr uint8_t kFaultDebounceMs = 5;  // nSF low for this long is a fault

static_assert(kDeadlineMs >= 500 && kDeadlineMs <= 2000, "the host deadline must be 500 to 2000 ms");
static_assert(kHoldPwm > 0 && kHoldPwm < kPwmLimit, "the budget has to fill and to drain");
static_assert(kFullDriveSeconds >= 1 && kFullDriveSeconds <= 1800, "the budget must end full drive within half an hour");
static_assert(kPwmTop >= 799, "the MC33926 allows at most 20 kHz");
static_assert(kReversalMs >= 1, "a direction change has to pass through zero");

}  // namespace config

#endif
