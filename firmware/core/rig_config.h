/* What this rig's firmware is built for. The host reads these figures from the HELLO reply and
 * refuses to arm a rig whose figures differ from its rig file. Those in #ifndef may be given to the compiler:
 * make DEFINES="-DCOUNTS_PER_REV=10000u -DCOUNTS_DOWN=1 -DMAX_SPEED=986u" */
#ifndef RIG_CONFIG_H
#define RIG_CONFIG_H

#define PROTOCOL_VERSION 1u

#ifndef COUNTS_PER_REV
#define COUNTS_PER_REV 504u       /* rising edges of encoder channel A, motor shaft */
#endif
#ifndef COUNTS_DOWN
#define COUNTS_DOWN 0             /* 1: a decoder gives a pulse and a direction, and the counts go down backwards */
#endif
#define TICK_US 20000u            /* one report per tick */
#define DAC_FULL_SCALE 20000u     /* motor torque at DAC code 255, unit 10 uNm: 0.2 Nm */
#define ADC_FULL_SCALE 25000u     /* motor torque at ADC code 255, unit 10 uNm: 0.25 Nm */

#define TORQUE_LIMIT_CODE 229u    /* 0.18 Nm: floor(0.18 / 0.2 * 255) */
#define CURRENT_LIMIT_CODE 193u   /* 0.189 Nm measured: the limit and 5 % for offset and noise */
#define CURRENT_LIMIT_TICKS 3u    /* consecutive readings above it */
#define WATCHDOG_TICKS 7u         /* the stage goes off 120..140 ms after the last heartbeat */
#ifndef MAX_SPEED
#define MAX_SPEED 400u            /* counts per tick: 249 rad/s at the motor */
#endif
#define MAX_TRAVEL 781u           /* 256 counts each, after arming: 12.8 turns of the load shaft */

#endif
