/* The rig's state machine: commands, ramp, limits, watchdog, latched faults, reports. */
#ifndef RIG_H
#define RIG_H

#include <stdint.h>

enum command { HELLO = 0x01, BEAT, TORQUE, ARM, STOP, CLEAR, RAMP, LIMITS };
enum answer { HELLO_REPLY = 0x81, REPORT };
enum state { DISARMED, ARMED, RAMPING, FAULT };
enum result {
    RESULT_OK, RESULT_UNKNOWN, RESULT_LENGTH, RESULT_VERSION,
    RESULT_NO_HELLO, RESULT_FAULT, RESULT_STATE, RESULT_RANGE
};
#define STATUS_STATE 0x03u
#define STATUS_HELLO 0x04u
#define STATUS_STAGE 0x08u
#define STATUS_RAMP_DONE 0x10u
#define BUILT_PULSED 0x04u
#define BUILT_COARSE 0x08u      /* full scales in units of 100 uNm instead of 10 */
#define FAULT_WATCHDOG 0x01u
#define FAULT_CURRENT 0x02u
#define FAULT_TRAVEL 0x04u
#define FAULT_SPEED 0x08u

void rig_reset(uint8_t cause);
void rig_poll(void);          /* one turn of the main loop */

#endif
