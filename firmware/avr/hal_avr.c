/* ATmega328P at 16 MHz (an Arduino Uno or Nano). Pins, by Arduino number:
 *   0, 1    UART            2      encoder A (INT0)
 *   4 .. 7  DAC bits 0..3   8..11  DAC bits 4..7
 *   12      power stage enable, active low, with a pull-up: off while the pins float after a reset
 *   A0      current sense
 * Enable and current sense can be given to the compiler: -DSTAGE_PIN=16 -DADC_CHANNEL=6; the rest is wired to the
 * processor's own functions. */
#include "hal.h"

#include "rig.h"
#include "rig_config.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>

#define BAUD_REGISTER 103u  /* 19200 baud with U2X: 16e6 / (8 * 104) = 19231, +0.16 % */
#define RX_RING 32u
#ifndef STAGE_PIN
#define STAGE_PIN 12        /* Arduino's number; 14 to 19 are A0 to A5 */
#endif
#ifndef ADC_CHANNEL
#define ADC_CHANNEL 0       /* A0 */
#endif
/* Not 13: the bootloader blinks it, and low is on. */
#if STAGE_PIN == 12
#define STAGE_PORT PORTB
#define STAGE_DDR DDRB
#define STAGE_BIT _BV(4)
#elif STAGE_PIN >= 14 && STAGE_PIN <= 19 && STAGE_PIN - 14 != ADC_CHANNEL
#define STAGE_PORT PORTC
#define STAGE_DDR DDRC
#define STAGE_BIT _BV(STAGE_PIN - 14)
#else
#error "STAGE_PIN: accepted are 12 and 14 to 19, but not the one of ADC_CHANNEL"
#endif
#if ADC_CHANNEL < 0 || ADC_CHANNEL > 7
#error "ADC_CHANNEL: accepted are 0 to 7, A0 to A7"
#endif

ROM uint8_t hal_target = TARGET_AVR;
uint16_t hal_tick_number;
uint16_t hal_tick_counts;

static volatile uint16_t edges, ticks, latched;
static volatile uint8_t rx_ring[RX_RING], rx_head;
static uint8_t rx_tail;
/* The bootloader or the watchdog leave their mark here before main() runs. */
static uint8_t mcusr_mirror __attribute__((section(".noinit")));

/* A watchdog reset leaves the watchdog on at its shortest period: stop it before anything else. */
void stop_watchdog(void) __attribute__((naked, used, section(".init3")));
void stop_watchdog(void)
{
    mcusr_mirror = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

ISR(INT0_vect)
{
    edges++;
}

/* Timer 2: 16 MHz / 256 / 250 = 250 Hz; five make a tick of exactly 20 ms. */
ISR(TIMER2_COMPA_vect)
{
    static uint8_t fifth;
    if (++fifth < 5u)
        return;
    fifth = 0;
    ticks++;
    latched = edges;
}

ISR(USART_RX_vect)
{
    rx_ring[rx_head] = UDR0;
    rx_head = (rx_head + 1u) % RX_RING;
}

uint8_t hal_tick(void)
{
    uint16_t now;
    cli();
    now = ticks;
    hal_tick_counts = latched;
    sei();
    if (now == hal_tick_number)
        return 0;
    hal_tick_number = now;
    wdt_reset();
    return 1;
}

void hal_dac(uint8_t code)
{
    PORTD = (uint8_t)((PORTD & 0x0f) | (uint8_t)(code << 4));
    PORTB = (uint8_t)((PORTB & 0xf0) | (code >> 4));
}

void hal_stage(uint8_t on)
{
    if (on)
        STAGE_PORT &= (uint8_t)~STAGE_BIT;
    else
        STAGE_PORT |= STAGE_BIT;
}

/* The converter runs freely, left-adjusted: its upper eight bits are as good as an ADC0804. */
uint8_t hal_adc(void) { return ADCH; }

uint8_t hal_rx_ready(void) { return rx_tail != rx_head; }

uint8_t hal_rx(void)
{
    uint8_t byte = rx_ring[rx_tail];
    rx_tail = (rx_tail + 1u) % RX_RING;
    return byte;
}

uint8_t hal_tx_ready(void) { return UCSR0A & _BV(UDRE0); }
void hal_tx(uint8_t byte) { UDR0 = byte; }

static uint8_t cause(void)
{
    if (mcusr_mirror & _BV(WDRF))
        return CAUSE_WATCHDOG;
    if (mcusr_mirror & _BV(BORF))
        return CAUSE_BROWN_OUT;
    if (mcusr_mirror & _BV(PORF))
        return CAUSE_POWER;
    return mcusr_mirror & _BV(EXTRF) ? CAUSE_EXTERNAL : CAUSE_UNKNOWN;
}

static void start_peripherals(void)
{
    STAGE_PORT |= STAGE_BIT;               /* before its direction: never low */
    STAGE_DDR |= STAGE_BIT;
    DDRB |= 0x0f;
    PORTD = _BV(PD2);                      /* pull-up for an open-collector encoder */
    DDRD = 0xf0;
    EICRA = _BV(ISC01) | _BV(ISC00);       /* rising edge */
    EIMSK = _BV(INT0);
    TCCR2A = _BV(WGM21);
    OCR2A = 249;
    TCCR2B = _BV(CS22) | _BV(CS21);
    TIMSK2 = _BV(OCIE2A);
    ADMUX = _BV(REFS0) | _BV(ADLAR) | ADC_CHANNEL;
    ADCSRB = 0;
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    UCSR0A = _BV(U2X0);                    /* before the divider: simavr computes the rate on that write */
    UBRR0 = BAUD_REGISTER;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    wdt_enable(WDTO_60MS);
    sei();
}

int main(void)
{
    start_peripherals();
    rig_reset(cause());
    for (;;)
        rig_poll();
}
