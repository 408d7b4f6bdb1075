#include "frame.h"

uint8_t frame_rx[FRAME_MAX_RX];
uint8_t frame_rx_length;
uint8_t frame_bad;
uint8_t frame_tx[FRAME_MAX_TX + 2u];
uint8_t frame_tx_length;

static uint8_t rx_count;      /* decoded bytes so far */
static uint8_t rx_run;        /* bytes until the next COBS code byte */
static bool rx_zero;          /* the current block ends in a zero that is still to be written */
static bool rx_spoilt;        /* too long or malformed: wait for the delimiter */
static bool rx_started;       /* at least one byte since the delimiter */
static uint16_t crc;

/* CRC-16/CCITT-FALSE (0x1021, not reflected), byte-wise without a table: the 8051 has no room for one. */
static void crc_byte(uint8_t byte)
{
    uint8_t x = (uint8_t)((crc >> 8) ^ byte);
    x ^= (uint8_t)(x >> 4);
    crc = (uint16_t)((crc << 8) ^ ((uint16_t)x << 12) ^ ((uint16_t)x << 5) ^ x);
}

static void rx_restart(void)
{
    rx_count = 0;
    rx_run = 0;
    rx_zero = false;
    rx_spoilt = false;
    rx_started = false;
}

void frame_reset(void)
{
    rx_restart();
    frame_bad = 0;
    frame_tx_length = 0;
}

static void rx_store(uint8_t byte)
{
    if (rx_count < FRAME_MAX_RX)
        frame_rx[rx_count++] = byte;
    else
        rx_spoilt = true;
}

static bool rx_intact(void)
{
    uint8_t i;
    if (rx_spoilt || rx_run || rx_count < 4u)
        return false;
    crc = 0xffffu;
    for (i = 0; i < (uint8_t)(rx_count - 2u); i++)
        crc_byte(frame_rx[i]);
    if ((uint8_t)crc != frame_rx[rx_count - 2u] || (uint8_t)(crc >> 8) != frame_rx[rx_count - 1u])
        return false;
    frame_rx_length = (uint8_t)(rx_count - 2u);
    return true;
}

static bool rx_close(void)
{
    bool intact;
    if (!rx_started)
        return false;         /* empty: a repeated delimiter is no error */
    intact = rx_intact();
    if (!intact)
        frame_bad++;
    rx_restart();
    return intact;
}

bool frame_receive(uint8_t byte)
{
    if (byte == 0)
        return rx_close();
    rx_started = true;
    if (rx_run) {
        rx_run--;
        rx_store(byte);
        return false;
    }
    if (rx_zero)
        rx_store(0);
    rx_run = (uint8_t)(byte - 1u);
    rx_zero = true;             /* frames are shorter than 254 bytes: every block but the last ends in a zero */
    return false;
}

void frame_send(uint8_t length)
{
    uint8_t i;
    uint8_t code = 0;         /* index of the open code byte */
    crc = 0xffffu;
    for (i = 1; i <= length; i++)
        crc_byte(frame_tx[i]);
    frame_tx[length + 1u] = (uint8_t)crc;
    frame_tx[length + 2u] = (uint8_t)(crc >> 8);
    for (i = 1; i <= (uint8_t)(length + 2u); i++) {
        if (frame_tx[i] == 0) {
            frame_tx[code] = (uint8_t)(i - code);
            code = i;
        }
    }
    frame_tx[code] = (uint8_t)(i - code);
    frame_tx[i] = 0;
    frame_tx_length = (uint8_t)(i + 1u);
}
