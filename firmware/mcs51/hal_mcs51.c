/* 89C51 or AT89S52 at 11.0592 MHz. Pins:
 *   P1    DAC0808                P2    ADC0804 in its self-clocking connection (WR tied to INTR)
 *   P3.0  RXD   P3.1  TXD        P3.2  encoder A (INT0, falling edge of the inverted signal)
 *   P3.4  power stage enable, active low: a reset sets all ports high, so off
 * DAC, ADC and enable can be given to the compiler: -DSTAGE_OFF=P3_5; the rest is wired to the processor's own
 * functions. */
#include <8051.h>
#include <stdbool.h>

#include "hal.h"
#include "rig.h"
#include "rig_config.h"

#define RX_RING 8u
#ifndef STAGE_OFF
#define STAGE_OFF P3_4
#endif
#ifndef DAC_PORT
#define DAC_PORT P1
#endif
#ifndef ADC_PORT
#define ADC_PORT P2
#endif
/* DAC and ADC on one port would drive against each other. */
#define JOINED(a, b) a##b
#define NUMBER(name) JOINED(IS_, name)
#define IS_P0 1
#define IS_P1 2
#define IS_P2 3
#define IS_P3_3 3
#define IS_P3_4 4
#define IS_P3_5 5
#define IS_P3_6 6
#define IS_P3_7 7
#if !NUMBER(DAC_PORT) || !NUMBER(ADC_PORT) || NUMBER(DAC_PORT) == NUMBER(ADC_PORT)
#error "DAC_PORT, ADC_PORT: accepted are P0, P1 and P2, one for each"
#endif
#if !NUMBER(STAGE_OFF)
#error "STAGE_OFF: accepted are P3_3 to P3_7"
#endif

__sfr __at(0xa6) WDTRST;     /* AT89S52's watchdog; a write the 89C51 does not notice */

ROM uint8_t hal_target = TARGET_MCS51;
uint16_t hal_tick_number;
uint16_t hal_tick_counts;

static volatile __data uint8_t edges;       /* read from assembly: one byte, one instruction */
static volatile __data uint8_t sub_ticks;
static volatile __data uint8_t quarter;     /* of a tick, counted down */
static volatile bool tick_due;
static uint8_t last_edges;
static volatile uint8_t rx_ring[RX_RING], rx_head;
static uint8_t rx_tail;
static volatile bool tx_busy;

/* A reset leaves P1 at 0xFF, full scale; clear it before the C start-up spends a millisecond on RAM. */
unsigned char _sdcc_external_startup(void)
{
    DAC_PORT = 0;
    return 0;
}

/* 20,000 edges a second leave 46 cycles each: two instructions, no register, no flag. */
void encoder_isr(void) __interrupt(0) __naked
{
    __asm
        inc _edges
        reti
    __endasm;
}

/* Timer 0 in mode 2 overflows every 256 cycles by itself; 72 overflows are 18432 cycles, 20 ms to
 * the cycle, so no reload in software can drift. Every 18 of them the edges are collected: their eight bits hold
 * 5 ms of up to 51,000 edges a second, 636 rad/s. The motor's supply ends at 533 rad/s; over 10 ms a motor that
 * runs away would look like a slow one. */
void timer_isr(void) __interrupt(1) __naked
{
    __asm
        djnz _sub_ticks, 00001$
        ljmp _five_milliseconds
    00001$:
        reti
    __endasm;
}

/* Only timer_isr jumps here; it is declared as a handler of an unused vector to get the prologue and
 * the RETI of one. It and the serial handler both have low priority, so they never nest. */
void five_milliseconds(void) __interrupt(7)
{
    uint8_t now = edges;
    sub_ticks = 18;
    hal_tick_counts += (uint8_t)(now - last_edges);
    last_edges = now;
    if (--quarter)
        return;
    quarter = 4;
    hal_tick_number++;
    tick_due = true;
}

void serial_isr(void) __interrupt(4)
{
    if (TI) {
        TI = 0;
        tx_busy = false;
    }
    if (RI) {
        RI = 0;
        rx_ring[rx_head] = SBUF;
        rx_head = (rx_head + 1u) & (RX_RING - 1u);
    }
}

/* The handler wrote number and counts; the core reads both within the 5 ms before it touches them again. */
uint8_t hal_tick(void)
{
    if (!tick_due)
        return 0;
    tick_due = false;
    WDTRST = 0x1e;
    WDTRST = 0xe1;
    return 1;
}

void hal_dac(uint8_t code) { DAC_PORT = code; }
void hal_stage(uint8_t on) { STAGE_OFF = !on; }
uint8_t hal_adc(void) { return ADC_PORT; }
uint8_t hal_rx_ready(void) { return rx_tail != rx_head; }

uint8_t hal_rx(void)
{
    uint8_t byte = rx_ring[rx_tail];
    rx_tail = (rx_tail + 1u) & (RX_RING - 1u);
    return byte;
}

uint8_t hal_tx_ready(void) { return !tx_busy; }

void hal_tx(uint8_t byte)
{
    tx_busy = true;
    SBUF = byte;
}

void main(void)
{
    uint8_t cause = PCON & 0x10 ? CAUSE_POWER : CAUSE_UNKNOWN;
    PCON = 0x80;             /* SMOD doubles the baud rate; clears the power-off flag */
    TMOD = 0x22;             /* timers 0 and 1: eight bits with automatic reload */
    TH0 = TL0 = 0;
    TH1 = TL1 = 0xfd;        /* 19200 baud */
    SCON = 0x50;
    sub_ticks = 18;
    quarter = 4;
    IT0 = 1;
    PX0 = 1;                 /* the encoder interrupts everything, and nothing interrupts it */
    TR0 = TR1 = 1;
    IE = 0x93;               /* serial, timer 0, external 0 */
    rig_reset(cause);
    for (;;)
        rig_poll();
}
