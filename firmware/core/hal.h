/* The hardware layer: what each board provides to the core. Everything is called from the main loop. */
#ifndef HAL_H
#define HAL_H

#include <stdint.h>

enum reset_cause { CAUSE_UNKNOWN, CAUSE_POWER, CAUSE_EXTERNAL, CAUSE_WATCHDOG, CAUSE_BROWN_OUT };
enum target { TARGET_NATIVE, TARGET_MCS51, TARGET_AVR };

#ifdef __SDCC_mcs51
#define ROM __code
#else
#define ROM const
#endif
extern ROM uint8_t hal_target;

/* A tick elapsed since the last call: latches its number and the encoder count at that instant. */
uint8_t hal_tick(void);
extern uint16_t hal_tick_number;  /* counted by the interrupt, not by the main loop */
extern uint16_t hal_tick_counts;  /* free-running encoder count, 16 bits */

void hal_dac(uint8_t code);
void hal_stage(uint8_t on);       /* the power stage's enable; off must be what a reset leaves */
uint8_t hal_adc(void);            /* latest current reading */

uint8_t hal_rx_ready(void);
uint8_t hal_rx(void);
uint8_t hal_tx_ready(void);
void hal_tx(uint8_t byte);

#endif
