#include "rig.h"

#include <stdbool.h>

#include "frame.h"
#include "hal.h"
#include "rig_config.h"

static uint8_t state;
static uint8_t fault;            /* latched; zero only after CLEAR */
static bool hello_seen;
static bool hello_pending;       /* the next tick answers HELLO instead of reporting */
static bool ramp_done;
static uint8_t ack_sequence;
static uint8_t ack_result;
static uint8_t reset_cause;

static uint8_t beat_age;         /* ticks since the last intact frame of an armed host */
static uint8_t over_current;     /* consecutive readings above the limit */
static uint8_t dac;
static uint8_t adc;
static uint16_t level;           /* ramp's torque, 1/256 code */
static uint16_t slope;           /* 1/256 code per tick */
static uint8_t ramp_end;
#if HOLD_TICKS
static uint8_t held;             /* ticks at the ramp's end */
#endif

static uint32_t counts;          /* cumulative since reset */
static uint16_t travel_start;    /* count at arming, in units of 256 */
static uint16_t travel_limit;    /* in units of 256 */
static uint16_t speed_limit;
static uint8_t tx_next;
static uint8_t report_sequence;

static void drive(uint8_t code)
{
    dac = code;
    hal_dac(code);
}


static void power_off(uint8_t next_state)
{
    hal_stage(0);
    drive(0);
    state = next_state;
}

static void trip(uint8_t bit)
{
    fault |= bit;
    power_off(FAULT);
}

void rig_reset(uint8_t cause)
{
    power_off(DISARMED);
    frame_reset();
    fault = 0;
    hello_seen = 0;
    hello_pending = 0;
    ramp_done = 0;
    ack_sequence = 0;
    ack_result = RESULT_NO_HELLO;
    reset_cause = cause;
    beat_age = 0;
    over_current = 0;
    adc = 0;
    level = 0;
    slope = 0;
    ramp_end = 0;
    counts = 0;
    travel_start = 0;
    travel_limit = MAX_TRAVEL;
    speed_limit = MAX_SPEED;
    tx_next = 0;
    report_sequence = 0;
}

static uint8_t arm(void)
{
    if (state != DISARMED)
        return RESULT_STATE;
    travel_start = (uint16_t)(counts >> 8);
    beat_age = 0;
    over_current = 0;
    ramp_done = 0;
    drive(0);
    hal_stage(1);
    state = ARMED;
    return RESULT_OK;
}

static uint8_t set_torque(uint8_t code)
{
    if (state != ARMED)
        return RESULT_STATE;
    if (code > TORQUE_LIMIT_CODE)
        return RESULT_RANGE;
    drive(code);
    return RESULT_OK;
}

static uint8_t start_ramp(uint16_t step)
{
    const uint8_t end = frame_rx[4];
    if (state != ARMED || dac != 0)
        return RESULT_STATE;
    if (end == 0 || end > TORQUE_LIMIT_CODE || step == 0 || step > 0x1000u)
        return RESULT_RANGE;
    slope = step;
    ramp_end = end;
#if HOLD_TICKS
    held = 0;
#endif
    level = 0x80u;               /* half a code: the staircase rounds, its mean is the ramp */
    ramp_done = 0;
    state = RAMPING;
    return RESULT_OK;
}

static uint8_t set_limits(uint16_t distance, uint16_t speed)
{
    if (state != DISARMED)
        return RESULT_STATE;
    if (distance == 0 || distance > MAX_TRAVEL || speed == 0 || speed > MAX_SPEED)
        return RESULT_RANGE;
    travel_limit = distance;
    speed_limit = speed;
    return RESULT_OK;
}

static uint8_t payload_length(uint8_t type)
{
    switch (type) {
    case HELLO:
        return 1;
    case TORQUE:
        return 1;
    case RAMP:
        return 3;
    case LIMITS:
        return 4;
    default:
        return 0;
    }
}

/* Commands that need a greeted, fault-free rig. */
static uint8_t guarded(uint8_t type)
{
    const uint8_t *p = frame_rx + 2;
    if (fault)
        return RESULT_FAULT;
    switch (type) {
    case ARM:
        return arm();
    case TORQUE:
        return set_torque(p[0]);
    case RAMP:
        return start_ramp((uint16_t)(p[0] | (uint16_t)p[1] << 8));
    default: /* LIMITS */
        return set_limits((uint16_t)(p[0] | (uint16_t)p[1] << 8),
                          (uint16_t)(p[2] | (uint16_t)p[3] << 8));
    }
}

static uint8_t greet(uint8_t version)
{
    power_off(fault ? FAULT : DISARMED); /* a new host takes over a rig at rest */
    hello_pending = 1;
    hello_seen = version == PROTOCOL_VERSION;
    return hello_seen ? RESULT_OK : RESULT_VERSION;
}

static uint8_t execute(uint8_t type)
{
    if (type < HELLO || type > LIMITS)
        return RESULT_UNKNOWN;
    if (frame_rx_length != (uint8_t)(payload_length(type) + 2u))
        return RESULT_LENGTH;
    if (type == HELLO)
        return greet(frame_rx[2]);
    if (type == STOP) {          /* always obeyed, greeted or not */
        power_off(fault ? FAULT : DISARMED);
        return RESULT_OK;
    }
    if (!hello_seen)
        return RESULT_NO_HELLO;
    if (type == CLEAR) {
        fault = 0;
        power_off(DISARMED);
        return RESULT_OK;
    }
    return guarded(type);
}

static void on_frame(void)
{
    uint8_t type = frame_rx[0];
    uint8_t sequence = frame_rx[1];
    beat_age = 0;
    if (type == BEAT && frame_rx_length == 2u)
        return;
    /* A repetition of the last command (its report was lost) is answered, not executed again. */
    if (hello_seen && sequence == ack_sequence && type != HELLO && type != STOP)
        return;
    ack_result = execute(type);
    ack_sequence = sequence;
}

/* Since arming, in units of 256 counts. */
static uint16_t travelled(void)
{
    return (uint16_t)((uint16_t)(counts >> 8) - travel_start);
}

/* Advances the counts to those of the tick; returns how many there were. */
static uint16_t count(void)
{
    uint16_t moved = (uint16_t)(hal_tick_counts - (uint16_t)counts);
    counts += moved;
    return moved;
}

static void supervise(uint16_t moved)
{
    if (state != ARMED && state != RAMPING)
        return;
    if (++beat_age >= WATCHDOG_TICKS)
        trip(FAULT_WATCHDOG);
    over_current = adc > CURRENT_LIMIT_CODE ? (uint8_t)(over_current + 1u) : 0;
    if (over_current >= CURRENT_LIMIT_TICKS)
        trip(FAULT_CURRENT);
    if (travelled() > travel_limit)
        trip(FAULT_TRAVEL);
    if (moved > speed_limit)
        trip(FAULT_SPEED);
}

static void advance_ramp(void)
{
    if (state != RAMPING)
        return;
#if PULSED
    hal_stage(0);
    hal_stage(1);
#endif
    if ((uint8_t)(level >> 8) >= ramp_end) {
#if HOLD_TICKS
        if (held++ < HOLD_TICKS) {
            drive(ramp_end);
            return;
        }
#endif
        ramp_done = 1;
        power_off(DISARMED);
        return;
    }
    drive((uint8_t)(level >> 8));
    level += slope;              /* at most 240 * 256 - 1 + 0x1000: no overflow */
}

static void put16(uint8_t at, uint16_t value)
{
    frame_tx[at] = (uint8_t)value;
    frame_tx[at + 1u] = (uint8_t)(value >> 8);
}

static void send_hello(void)
{
    frame_tx[1] = HELLO_REPLY;
    frame_tx[2] = ack_sequence;
    frame_tx[3] = PROTOCOL_VERSION;
    frame_tx[4] = hal_target;
    frame_tx[5] = reset_cause;
    put16(6, COUNTS_PER_REV);
    put16(8, TICK_US);
    put16(10, DAC_FULL_SCALE);
    put16(12, ADC_FULL_SCALE);
    frame_tx[14] = TORQUE_LIMIT_CODE;
    frame_tx[15] = WATCHDOG_TICKS;
    frame_tx[16] = (PULSED ? BUILT_PULSED : 0u) | (SCALE_UNIT == 100u ? BUILT_COARSE : 0u);
    frame_tx[17] = HOLD_TICKS;
    frame_send(17);
}

static void send_report(void)
{
    frame_tx[1] = REPORT;
    frame_tx[2] = report_sequence++;
    put16(3, hal_tick_number);
    put16(5, (uint16_t)counts);
    frame_tx[7] = (uint8_t)(counts >> 16);
    frame_tx[8] = dac;
    frame_tx[9] = adc;
    frame_tx[10] = (uint8_t)(state | (hello_seen ? STATUS_HELLO : 0u)
                             | (state == ARMED || state == RAMPING ? STATUS_STAGE : 0u)
                             | (ramp_done ? STATUS_RAMP_DONE : 0u));
    frame_tx[11] = fault;
    frame_tx[12] = ack_sequence;
    frame_tx[13] = ack_result;
    frame_tx[14] = frame_bad;
    frame_send(14);
}

static void on_tick(void)
{
    uint16_t moved = count();
    adc = hal_adc();
    supervise(moved);
    advance_ramp();
    tx_next = 0;
    if (hello_pending) {
        hello_pending = 0;
        send_hello();
    } else {
        send_report();
    }
}

void rig_poll(void)
{
    if (hal_tick())
        on_tick();
    if (hal_rx_ready() && frame_receive(hal_rx()))
        on_frame();
    if (frame_tx_length && hal_tx_ready()) {
        hal_tx(frame_tx[tx_next++]);
        if (tx_next == frame_tx_length) {
            frame_tx_length = 0;
            tx_next = 0;
        }
    }
}
