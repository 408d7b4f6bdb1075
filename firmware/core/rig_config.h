/* What this rig's firmware is built for. The host reads scales and figures from the HELLO reply and refuses to arm
 * a rig whose figures differ from its rig file. Each may be given to the compiler instead of being edited here:
 * make firmware DEFINES="-DCOUNTS_PER_REV=1000u -DMAX_SPEED=800u"
 * The table of them all, pins included, is in docs/reference/rig_protocol.md. */
#ifndef RIG_CONFIG_H
#define RIG_CONFIG_H

#define PROTOCOL_VERSION 2u

#ifndef COUNTS_PER_REV
#define COUNTS_PER_REV 504u       /* rising edges of encoder channel A, motor shaft */
#endif
#define TICK_US 20000u            /* one report per tick; the timers of both boards count it: not to be given */
#ifndef SCALE_UNIT
#define SCALE_UNIT 10u            /* of both full scales, uNm: 10 or 100 */
#endif
#ifndef DAC_FULL_SCALE
#define DAC_FULL_SCALE 20000u     /* motor torque at DAC code 255, in SCALE_UNIT: 0.2 Nm */
#endif
#ifndef ADC_FULL_SCALE
#define ADC_FULL_SCALE 25000u     /* motor torque at ADC code 255, in SCALE_UNIT: 0.25 Nm */
#endif

#ifndef TORQUE_LIMIT_CODE
#define TORQUE_LIMIT_CODE 229u    /* 0.18 Nm: floor(0.18 / 0.2 * 255) */
#endif
#ifndef CURRENT_LIMIT_CODE
#define CURRENT_LIMIT_CODE 193u   /* 0.189 Nm measured: the limit and 5 % for offset and noise */
#endif
#ifndef HOLD_TICKS
#define HOLD_TICKS 0u             /* for which a ramp's end torque is held, at most 254 */
#endif
#ifndef PULSED
#define PULSED 0                  /* 1: a ramp is on for a tick and off for the moment of a port write, as the source's */
#endif
#ifndef CURRENT_LIMIT_TICKS
#define CURRENT_LIMIT_TICKS 3u    /* consecutive readings above it */
#endif
#ifndef WATCHDOG_TICKS
#define WATCHDOG_TICKS 7u         /* the stage goes off 120..140 ms after the last heartbeat */
#endif
#ifndef MAX_SPEED
#define MAX_SPEED 400u            /* counts per tick: 249 rad/s at the motor */
#endif
#ifndef MAX_TRAVEL
#define MAX_TRAVEL 781u           /* 256 counts each, after arming: 12.8 turns of the load shaft */
#endif

/* The ramp's level, 256 * code + slope, must fit 16 bits; a limit that no reading exceeds would be none. */
#if TORQUE_LIMIT_CODE < 1 || TORQUE_LIMIT_CODE > 240
#error "TORQUE_LIMIT_CODE: accepted are 1 to 240"
#endif
#if CURRENT_LIMIT_CODE < 1 || CURRENT_LIMIT_CODE > 254
#error "CURRENT_LIMIT_CODE: accepted are 1 to 254, because no reading is above 255"
#endif
#if WATCHDOG_TICKS < 2 || WATCHDOG_TICKS > 255 || CURRENT_LIMIT_TICKS < 1 || CURRENT_LIMIT_TICKS > 255
#error "WATCHDOG_TICKS: accepted are 2 to 255; CURRENT_LIMIT_TICKS: 1 to 255"
#endif
#if DAC_FULL_SCALE < 1 || DAC_FULL_SCALE > 65535 || ADC_FULL_SCALE < 1 || ADC_FULL_SCALE > 65535
#error "DAC_FULL_SCALE, ADC_FULL_SCALE: accepted are 1 to 65535, in SCALE_UNIT"
#endif
#if SCALE_UNIT != 10 && SCALE_UNIT != 100
#error "SCALE_UNIT: accepted are 10 and 100, in uNm"
#endif
#if PULSED != 0 && PULSED != 1
#error "PULSED: accepted are 0 and 1"
#endif
#if COUNTS_PER_REV < 1 || COUNTS_PER_REV > 65535
#error "COUNTS_PER_REV: accepted are 1 to 65535"
#endif
#if HOLD_TICKS > 254
#error "HOLD_TICKS: accepted are 0 to 254"
#endif
#if MAX_SPEED < 1 || MAX_SPEED > 32767 || MAX_TRAVEL < 1 || MAX_TRAVEL > 32767
#error "MAX_SPEED, MAX_TRAVEL: accepted are 1 to 32767"
#endif

#endif
