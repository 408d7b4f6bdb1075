/* Frames: COBS(type, sequence, payload, CRC-16/CCITT-FALSE little-endian), then 0x00. */
#ifndef FRAME_H
#define FRAME_H

#include <stdbool.h>
#include <stdint.h>

#define FRAME_MAX_RX 8u   /* the longest command: type, sequence, four bytes of payload, CRC */
#define FRAME_MAX_TX 19u  /* the longest answer before COBS */

extern uint8_t frame_rx[FRAME_MAX_RX];
extern uint8_t frame_rx_length;      /* of the frame last accepted, without its CRC */
extern uint8_t frame_bad;            /* frames refused since reset, modulo 256 */
extern uint8_t frame_tx[FRAME_MAX_TX + 2u];  /* the raw frame starts at index 1 */
extern uint8_t frame_tx_length;      /* encoded bytes to send, 0 when idle */

void frame_reset(void);
bool frame_receive(uint8_t byte);    /* true when `byte` closes an intact frame, now in frame_rx */
void frame_send(uint8_t length);     /* seals the raw frame of `length` bytes at frame_tx + 1 */

#endif
