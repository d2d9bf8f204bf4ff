/* stm32f4_regs.h - registers of an STM32F405 that its boards need: clocks (RCC), flash interface,
 * pins, USART, independent watchdog (RM0090).
 *
 * Names are the reference manual's. A test compares offsets, fields, addresses and interrupt
 * numbers with published register data.
 */
#ifndef BERTH_HAL_STM32F4_REGS_H
#define BERTH_HAL_STM32F4_REGS_H

#include "stm32_io.h"

#include <stdint.h>

typedef struct {
    volatile uint32_t cr;
    volatile uint32_t pllcfgr;
    volatile uint32_t cfgr;
    volatile uint32_t cir;
    volatile uint32_t ahb1rstr;
    volatile uint32_t ahb2rstr;
    volatile uint32_t ahb3rstr;
    uint32_t reserved_1c;
    volatile uint32_t apb1rstr;
    volatile uint32_t apb2rstr;
    uint32_t reserved_28[2];
    volatile uint32_t ahb1enr;
    volatile uint32_t ahb2enr;
    volatile uint32_t ahb3enr;
    uint32_t reserved_3c;
    volatile uint32_t apb1enr;
    volatile uint32_t apb2enr;
    uint32_t reserved_48[10];
    volatile uint32_t bdcr;
    volatile uint32_t csr;
} stm32f4_rcc_t;

typedef struct {
    volatile uint32_t acr;
    volatile uint32_t keyr;
    volatile uint32_t optkeyr;
    volatile uint32_t sr;
} stm32f4_flash_t;

typedef struct {
    volatile uint32_t moder;
    volatile uint32_t otyper;
    volatile uint32_t ospeedr;
    volatile uint32_t pupdr;
    volatile uint32_t idr;
    volatile uint32_t odr;
    volatile uint32_t bsrr;
    volatile uint32_t lckr;
    volatile uint32_t afrl;
    volatile uint32_t afrh;
} stm32f4_gpio_t;

typedef struct {
    volatile uint32_t sr;
    volatile uint32_t dr;
    volatile uint32_t brr;
    volatile uint32_t cr1;
    volatile uint32_t cr2;
    volatile uint32_t cr3;
} stm32f4_usart_t;

typedef struct {
    volatile uint32_t kr;
    volatile uint32_t pr;
    volatile uint32_t rlr;
    volatile uint32_t sr;
} stm32f4_iwdg_t;

#define STM32F4_RCC_ADDRESS 0x40023800u
#define STM32F4_FLASH_ADDRESS 0x40023c00u
#define STM32F4_GPIOA_ADDRESS 0x40020000u
#define STM32F4_GPIOB_ADDRESS 0x40020400u
#define STM32F4_USART1_ADDRESS 0x40011000u
#define STM32F4_IWDG_ADDRESS 0x40003000u
#define STM32F4_USART1_IRQ 37

#define RCC_CR_HSION STM32_BIT(0)
#define RCC_CR_HSIRDY STM32_BIT(1)
#define RCC_CR_HSEON STM32_BIT(16)
#define RCC_CR_HSERDY STM32_BIT(17)
#define RCC_CR_HSEBYP STM32_BIT(18)
#define RCC_CR_CSSON STM32_BIT(19)
#define RCC_CR_PLLON STM32_BIT(24)
#define RCC_CR_PLLRDY STM32_BIT(25)

#define RCC_PLLCFGR_PLLM STM32_FIELD(0, 6)
#define RCC_PLLCFGR_PLLN STM32_FIELD(6, 9)
#define RCC_PLLCFGR_PLLP STM32_FIELD(16, 2)
#define RCC_PLLCFGR_PLLSRC STM32_BIT(22)
#define RCC_PLLCFGR_PLLQ STM32_FIELD(24, 4)

#define RCC_CFGR_SW STM32_FIELD(0, 2)
#define RCC_CFGR_SWS STM32_FIELD(2, 2)
#define RCC_CFGR_HPRE STM32_FIELD(4, 4)
#define RCC_CFGR_PPRE1 STM32_FIELD(10, 3)
#define RCC_CFGR_PPRE2 STM32_FIELD(13, 3)

#define RCC_AHB1ENR_GPIOAEN STM32_BIT(0)
#define RCC_AHB1ENR_GPIOBEN STM32_BIT(1)
#define RCC_APB1ENR_CAN1EN STM32_BIT(25)
#define RCC_APB2ENR_USART1EN STM32_BIT(4)

#define RCC_CSR_RMVF STM32_BIT(24)
#define RCC_CSR_WDGRSTF STM32_BIT(29)

#define FLASH_ACR_LATENCY STM32_FIELD(0, 3)
#define FLASH_ACR_PRFTEN STM32_BIT(8)
#define FLASH_ACR_ICEN STM32_BIT(9)
#define FLASH_ACR_DCEN STM32_BIT(10)

#define USART_SR_ORE STM32_BIT(3)
#define USART_SR_RXNE STM32_BIT(5)
#define USART_SR_TC STM32_BIT(6)
#define USART_SR_TXE STM32_BIT(7)

#define USART_CR1_RE STM32_BIT(2)
#define USART_CR1_TE STM32_BIT(3)
#define USART_CR1_RXNEIE STM32_BIT(5)
#define USART_CR1_TXEIE STM32_BIT(7)
#define USART_CR1_UE STM32_BIT(13)

#define IWDG_SR_PVU STM32_BIT(0)
#define IWDG_SR_RVU STM32_BIT(1)

#endif
