// Vectors that a program may define, memory set-up, main(), and a place to stop.
    .syntax unified
    .cpu cortex-m3
    .thumb

    .section .vectors, "a"
    .word stack_top
    .word reset
    .word nmi_handler
    .word hardfault_handler
    .word memmanage_handler
    .word busfault_handler
    .word usagefault_handler
    .word 0, 0, 0, 0
    .word svc_handler
    .word 0, 0
    .word pendsv_handler
    .word systick_handler
    .word irq0_handler, irq1_handler, irq2_handler, irq3_handler
    .rept 4
    .word unexpected
    .endr
    .word uart_handler
    .rept 4
    .word unexpected
    .endr
    .word pioc_handler
    .word piod_handler
    .rept 22
    .word unexpected
    .endr
    .word adc_handler
    .rept 7
    .word unexpected
    .endr

    .text
    .macro default name
    .weak \name
    .thumb_set \name, unexpected
    .endm
    default nmi_handler
    default hardfault_handler
    default memmanage_handler
    default busfault_handler
    default usagefault_handler
    default svc_handler
    default pendsv_handler
    default systick_handler
    default irq0_handler
    default irq1_handler
    default irq2_handler
    default irq3_handler
    default uart_handler
    default pioc_handler
    default piod_handler
    default adc_handler

    .global reset
    .thumb_func
    .type reset, %function
reset:
    ldr r0, =data_load
    ldr r1, =data_start
    ldr r2, =data_end
1:  cmp r1, r2
    ittt lo
    ldrlo r3, [r0], #4
    strlo r3, [r1], #4
    blo 1b
    ldr r1, =bss_start
    ldr r2, =bss_end
    movs r3, #0
2:  cmp r1, r2
    itt lo
    strlo r3, [r1], #4
    blo 2b
    bl main
    .global finished
    .thumb_func
    .type finished, %function
finished:
    b finished
    .thumb_func
    .type unexpected, %function
unexpected:
    b unexpected
    .ltorg
