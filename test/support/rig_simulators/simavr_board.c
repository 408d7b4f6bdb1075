/* An ATmega328P on a rig's board, for ctypes: simavr runs the firmware's real binary, cycle by cycle. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>

#define LINE 4096u
#define CYCLES_PER_US 16u
#define BYTE_CYCLES (CYCLES_PER_US * 10000000u / 19200u)
enum { PINB_DDR = 0x24, PORTB = 0x25, DDRD = 0x2a, PORTD = 0x2b };

struct board {
    avr_t *avr;
    avr_irq_t *rx, *adc, *encoder;
    uint8_t to_rig[LINE], from_rig[LINE];
    uint32_t to_head, to_tail, from_head, from_tail;
    avr_cycle_count_t next_byte;
    uint8_t worst_dac;
};

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct board *board = param;
    (void)irq;
    board->from_rig[board->from_head++ % LINE] = (uint8_t)value;
}

struct board *board_new(uint8_t *flash, uint32_t size)
{
    struct board *board = calloc(1, sizeof *board);
    uint32_t flags = 0;
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->log = LOG_NONE;
    avr->frequency = 1000000u * CYCLES_PER_US;
    avr->vcc = avr->avcc = avr->aref = 5000;
    avr_loadcode(avr, flash, size, 0);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, board);
    board->avr = avr;
    board->rx = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    board->adc = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    board->encoder = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2);
    return board;
}

void board_reset(struct board *board)
{
    avr_reset(board->avr);
    board->to_tail = board->to_head;
}

void board_write(struct board *board, const uint8_t *bytes, uint32_t length)
{
    while (length--)
        board->to_rig[board->to_head++ % LINE] = *bytes++;
}

uint32_t board_read(struct board *board, uint8_t *bytes, uint32_t room)
{
    uint32_t done = 0;
    while (done < room && board->from_head != board->from_tail)
        bytes[done++] = board->from_rig[board->from_tail++ % LINE];
    return done;
}

uint8_t board_stage(const struct board *board)
{
    const uint8_t *io = board->avr->data;
    return (io[PINB_DDR] & 0x10) && !(io[PORTB] & 0x10);
}

/* A register of the data space: what a moved pin does. */
uint8_t board_register(const struct board *board, uint16_t address) { return board->avr->data[address]; }

/* The channel on which the current is sensed. */
void board_sense(struct board *board, uint8_t channel)
{
    board->adc = avr_io_getirq(board->avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + channel);
}

/* Pins that are still inputs read as zero: the DAC's inputs have pull-downs. */
uint8_t board_dac(const struct board *board)
{
    const uint8_t *io = board->avr->data;
    return (uint8_t)((io[PORTD] & io[DDRD]) >> 4 | (io[PORTB] & io[PINB_DDR] & 0x0f) << 4);
}

/* The highest code seen on the DAC since the last call while the power stage was on. */
uint8_t board_worst_dac(struct board *board)
{
    uint8_t worst = board->worst_dac;
    board->worst_dac = 0;
    return worst;
}

static void run_until(struct board *board, avr_cycle_count_t end)
{
    avr_t *avr = board->avr;
    while (avr->cycle < end) {
        if (board->to_head != board->to_tail && avr->cycle >= board->next_byte) {
            avr_raise_irq(board->rx, board->to_rig[board->to_tail++ % LINE]);
            board->next_byte = avr->cycle + BYTE_CYCLES;
        }
        avr_run(avr);
        if (board_stage(board) && board_dac(board) > board->worst_dac)
            board->worst_dac = board_dac(board);
    }
}

void board_run(struct board *board, uint32_t us, uint16_t edges, uint8_t reading)
{
    avr_cycle_count_t start = board->avr->cycle;
    avr_cycle_count_t length = (avr_cycle_count_t)us * CYCLES_PER_US;
    uint16_t i;
    avr_raise_irq(board->adc, (reading * 5000u + 2500u) / 256u);
    for (i = 0; i < edges; i++) {
        run_until(board, start + length * (i + 1u) / (edges + 1u));
        avr_raise_irq(board->encoder, 0);
        avr_raise_irq(board->encoder, 1); /* idles high, by the pull-up */
    }
    run_until(board, start + length);
}

void board_free(struct board *board)
{
    avr_terminate(board->avr);
    free(board->avr);
    free(board);
}
