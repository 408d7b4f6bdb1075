/* Native hardware layer: the board is a structure that the host program fills and reads.
 * Time advances only in native_run(): one call is one slice, TICK_US / slices of a tick. */
#include "hal.h"

#include "rig.h"
#include "rig_config.h"

#include <string.h>

#define LINE 4096u

struct line {
    uint8_t bytes[LINE];
    uint32_t head, tail;
};

ROM uint8_t hal_target = TARGET_NATIVE;
uint16_t hal_tick_number;
uint16_t hal_tick_counts;

static struct line to_rig, from_rig;
static uint16_t counter;
static uint32_t elapsed_us, next_tick_us;
static uint32_t byte_us, rx_credit_us, tx_credit_us; /* the line carries a byte in byte_us */
static uint8_t dac, stage, adc;
static uint8_t switched;           /* the stage came on since the host last asked */

static void push(struct line *line, uint8_t byte)
{
    line->bytes[line->head++ % LINE] = byte;
}

static uint8_t pop(struct line *line)
{
    return line->bytes[line->tail++ % LINE];
}

uint8_t hal_tick(void)
{
    if (elapsed_us < next_tick_us)
        return 0;
    next_tick_us += TICK_US;
    hal_tick_number++;
    hal_tick_counts = counter;
    return 1;
}

void hal_dac(uint8_t code) { dac = code; }

void hal_stage(uint8_t on)
{
    switched |= (uint8_t)(on && !stage);
    stage = on;
}

uint8_t hal_adc(void) { return adc; }
uint8_t hal_rx_ready(void) { return to_rig.head != to_rig.tail && rx_credit_us >= byte_us; }
uint8_t hal_tx_ready(void) { return tx_credit_us >= byte_us; }

uint8_t hal_rx(void)
{
    rx_credit_us -= byte_us;
    return pop(&to_rig);
}

void hal_tx(uint8_t byte)
{
    tx_credit_us -= byte_us;
    if (from_rig.head - from_rig.tail < LINE)
        push(&from_rig, byte);
}

/* Powers the board up. DAC and stage start as a board's latches may: full scale, and off. */
void native_power_up(uint32_t baud, uint8_t cause)
{
    memset(&to_rig, 0, sizeof to_rig);
    memset(&from_rig, 0, sizeof from_rig);
    counter = 0;
    elapsed_us = 0;
    next_tick_us = TICK_US;
    byte_us = 10000000u / baud;
    rx_credit_us = tx_credit_us = 0;
    hal_tick_number = 0;
    hal_tick_counts = 0;
    adc = 0;
    dac = 0xff;
    stage = 0;
    switched = 0;
    rig_reset(cause);
}

uint32_t native_write(const uint8_t *bytes, uint32_t length)
{
    uint32_t done = 0;
    while (done < length && to_rig.head - to_rig.tail < LINE)
        push(&to_rig, bytes[done++]);
    return done;
}

uint32_t native_read(uint8_t *bytes, uint32_t room)
{
    uint32_t done = 0;
    while (done < room && from_rig.head != from_rig.tail)
        bytes[done++] = pop(&from_rig);
    return done;
}

/* Runs the firmware over `us` microseconds in which the encoder gave `edges` and the ADC reads `reading`. */
void native_run(uint32_t us, uint16_t edges, uint8_t reading)
{
    uint32_t before;
    elapsed_us += us;
    counter = (uint16_t)(counter + edges);
    adc = reading;
    rx_credit_us = to_rig.head == to_rig.tail ? 0 : rx_credit_us + us;
    tx_credit_us += us;
    if (tx_credit_us > us + byte_us)
        tx_credit_us = us + byte_us; /* an idle line saves nothing up */
    do {
        before = to_rig.tail + from_rig.head;
        rig_poll();
    } while (before != to_rig.tail + from_rig.head || elapsed_us >= next_tick_us);
}

uint8_t native_dac(void) { return dac; }
uint8_t native_stage(void) { return stage; }

uint8_t native_switched(void)
{
    uint8_t was = switched;
    switched = 0;
    return was;
}
