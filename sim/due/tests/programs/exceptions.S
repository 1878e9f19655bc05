// Exception behaviour, one scenario a run. Each step leaves words in the trace; test_exceptions.py
// says which ones the architecture manual asks for.
    .syntax unified
    .cpu cortex-m3
    .thumb

    .equ SCENARIO, 0x20071000
    .equ TRACE, 0x20071100
    .equ ISER, 0xE000E100
    .equ ISPR, 0xE000E200
    .equ IPR, 0xE000E400
    .equ ICSR, 0xE000ED04
    .equ SHPR2, 0xE000ED1C
    .equ SHCSR, 0xE000ED24
    .equ CCR, 0xE000ED14
    .equ SCR, 0xE000ED10
    .equ CFSR, 0xE000ED28
    .equ HFSR, 0xE000ED2C

    // r11 points behind the last word of the trace; no handler saves it.
    .macro trace value
    ldr r12, =\value
    str r12, [r11], #4
    .endm
    .macro trace_reg reg
    str \reg, [r11], #4
    .endm
    // A mark, the exception number, EXC_RETURN.
    .macro entered mark
    trace \mark
    mrs r12, ipsr
    trace_reg r12
    trace_reg lr
    .endm
    .macro function name
    .global \name
    .thumb_func
    .type \name, %function
\name:
    .endm
    .macro poke address, value
    ldr r0, =\address
    ldr r1, =\value
    str r1, [r0]
    .endm
    .macro skip_instruction size
    mrs r0, msp
    ldr r1, [r0, #24]
    add r1, #\size
    str r1, [r0, #24]
    .endm

function main
    ldr r11, =TRACE
    ldr r0, =SCENARIO
    ldr r0, [r0]
    tbh [pc, r0, lsl #1]
table:
    .hword (svc_from_thread - table) / 2
    .hword (nested - table) / 2
    .hword (tail_chain - table) / 2
    .hword (process_stack - table) / 2
    .hword (undefined_usage - table) / 2
    .hword (undefined_hard - table) / 2
    .hword (coprocessor - table) / 2
    .hword (dsp - table) / 2
    .hword (divide - table) / 2
    .hword (unaligned_multiple - table) / 2
    .hword (bus_fault - table) / 2
    .hword (bad_return - table) / 2
    .hword (masks - table) / 2
    .hword (sleep_masked - table) / 2
    .hword (breakpoint - table) / 2
    .hword (double_fault - table) / 2
    .hword (odd_stack - table) / 2
    .hword (svc_blocked - table) / 2
    .hword (svc_in_it - table) / 2
    .hword (exclusive - table) / 2
    .hword (sleep_on_exit - table) / 2
    .hword (events - table) / 2
    .hword (even_branch - table) / 2
    .hword (unprivileged - table) / 2
    .hword (base_priority - table) / 2
    .hword (pendsv_last - table) / 2
    .hword (bit_band - table) / 2
    .hword (write_own_pending - table) / 2
    .hword (grouping - table) / 2
    .hword (late_arrival - table) / 2
done:
    trace 0xD0E
    b finished

// 0: SVC returns behind itself, registers kept.
svc_from_thread:
    movs r0, #1
    movs r1, #2
    movs r2, #3
    movs r3, #4
    svc 5
    trace_reg r0
    trace_reg r3
    b done

// 1: a more urgent interrupt preempts a handler.
nested:
    poke IPR, 0x00001080
    poke ISER, 7
    poke ISPR, 1
    trace 0x7E
    b done

// 2: a less urgent one waits and is tail-chained, on the same frame.
tail_chain:
    poke IPR, 0x00C0A080
    poke ISER, 7
    poke ISPR, 7
    trace 0x7E
    b done

// 3: thread on PSP.
process_stack:
    ldr r0, =0x20075000
    msr psp, r0
    movs r0, #2
    msr control, r0
    isb
    svc 0
    mrs r0, psp
    trace_reg r0
    b done

// 4, 5: an undefined instruction with and without UsageFault enabled.
undefined_usage:
    poke SHCSR, 1 << 18
    udf #0
    trace 0x7E
    b done
undefined_hard:
    udf #0
    trace 0x7E
    b done

// 6: vadd.f32 s0, s0, s1
coprocessor:
    poke SHCSR, 1 << 18
    .inst.w 0xEE300A20
    trace 0x7E
    b done

// 7: sadd16 r0, r0, r1
dsp:
    poke SHCSR, 1 << 18
    .inst.w 0xFA90F001
    trace 0x7E
    b done

// 8: division by zero, without and with its trap.
divide:
    movs r0, #7
    movs r1, #0
    udiv r2, r0, r1
    trace_reg r2
    poke SHCSR, 1 << 18
    poke CCR, 0x210
    movs r1, #0
    udiv r2, r0, r1
    trace 0x7E
    b done

// 9: LDM from an address that is no multiple of 4.
unaligned_multiple:
    poke SHCSR, 1 << 18
    ldr r0, =0x20072002
    ldm.w r0, {r1, r2}
    trace 0x7E
    b done

// 10: a load from nowhere.
bus_fault:
    poke SHCSR, 1 << 17
    ldr r0, =0x90000000
    ldr.w r1, [r0]
    trace 0x7E
    b done

// 11: an EXC_RETURN that does not exist: the SVC handler makes it.
bad_return:
    poke SHCSR, 1 << 18
    svc 11
    b done

// 12: PRIMASK holds an interrupt back until it is cleared.
masks:
    poke ISER, 1
    cpsid i
    poke ISPR, 1
    trace 0xA1
    cpsie i
    trace 0xA2
    b done

// 13: WFI ends on a masked interrupt, which runs when the mask goes.
sleep_masked:
    cpsid i
    poke 0xE000E014, 100
    poke 0xE000E018, 0
    poke 0xE000E010, 7
    wfi
    trace 0xA1
    movs r1, #0
    ldr r0, =0xE000E010
    str r1, [r0]
    cpsie i
    trace 0xA2
    b done

// 14: BKPT without a debugger.
breakpoint:
    bkpt #0
    trace 0x7E
    b done

// 15: a fault inside of HardFault.
double_fault:
    udf #1
    b done

// 16: the frame is aligned to 8 bytes and SP comes back.
odd_stack:
    sub sp, #4
    mov r4, sp
    svc 16
    mov r5, sp
    subs r5, r4
    trace_reg r5
    add sp, #4
    b done

// 17: SVC where it cannot be taken.
svc_blocked:
    cpsid i
    svc 0
    trace 0x7E
    b done

// 18: SVC in the middle of an IT block; the rest of the block runs after it.
svc_in_it:
    movs r0, #0
    movs r5, #0
    cmp r0, #0
    ittet eq
    moveq r5, #1
    svceq 0
    movne r5, #9
    addeq r5, #4
    trace_reg r5
    b done

// 19: an exception clears the exclusive monitor.
exclusive:
    ldr r0, =0x20072000
    ldrex r1, [r0]
    strex r2, r1, [r0]
    trace_reg r2
    ldrex r1, [r0]
    svc 0
    ldr r0, =0x20072000
    strex r2, r1, [r0]
    trace_reg r2
    b done

// 20: with SLEEPONEXIT the thread does not run on after the handler.
sleep_on_exit:
    poke ISER, 1
    poke SCR, 2
    poke ISPR, 1
    trace 0xBAD
    b done

// 21: WFE passes once after SEV, then sleeps until an interrupt.
events:
    sev
    wfe
    trace 0xA1
    poke 0xE000E014, 100
    poke 0xE000E018, 0
    poke 0xE000E010, 7
    wfe
    trace 0xA2
    b done

// 22: BX to an even address.
even_branch:
    poke SHCSR, 1 << 18
    ldr r0, =after_even
    bic r0, #1
    bx r0
    .balign 4
after_even:
    nop
    trace 0x7E
    b done

// 23: unprivileged thread may not touch the NVIC, nor raise itself.
unprivileged:
    poke SHCSR, 1 << 17
    movs r0, #1
    msr control, r0
    isb
    movs r0, #0
    msr control, r0
    mrs r0, control
    trace_reg r0
    ldr r0, =ISPR
    ldr.w r1, [r0]
    trace 0x7E
    b done

// 24: BASEPRI holds back what is not more urgent.
base_priority:
    poke IPR, 0x00004080
    poke ISER, 3
    movs r0, #0x60
    msr basepri, r0
    poke ISPR, 3
    trace 0xA1
    movs r0, #0
    msr basepri, r0
    trace 0xA2
    b done

// 25: PendSV, least urgent, runs when the SVC handler that asked for it is done.
pendsv_last:
    poke 0xE000ED20, 0x00F00000
    svc 25
    trace 0x7E
    b done

// 26: bit bands of SRAM and peripherals.
bit_band:
    poke 0x20002000, 0x00000081
    ldr r0, =0x22040000 + 7 * 4
    ldr r1, [r0]
    trace_reg r1
    movs r1, #1
    ldr r0, =0x22040000 + 12 * 4
    str r1, [r0]
    ldr r0, =0x20002000
    ldr r1, [r0]
    trace_reg r1
    movs r1, #1
    // PIOB_OWER bit 3, then PIOB_OWSR through the alias of that bit.
    ldr r0, =0x400E10A0
    movs r1, #8
    str r1, [r0]
    ldr r0, =0x42000000 + 0xE10A8 * 32 + 3 * 4
    ldr r1, [r0]
    trace_reg r1
    b done

// 27: an interrupt that pends itself again runs twice.
write_own_pending:
    poke ISER, 8
    poke ISPR, 8
    trace 0x7E
    b done

// 28: priorities of one group do not preempt each other.
grouping:
    poke 0xE000ED0C, 0x05FA0500
    poke IPR, 0x00001030
    poke ISER, 3
    poke ISPR, 1
    trace 0x7E
    b done

// 29: SysTick, most urgent, comes a chosen number of cycles after the start.
late_arrival:
    poke IPR, 0x00000080
    poke ISER, 1
    ldr r0, =0xE000E014
    ldr r1, =SCENARIO
    ldr r1, [r1, #4]
    str r1, [r0]
    ldr r3, =ISPR
    movs r4, #1
    ldr r5, =0xA1
    movs r2, #0
    str r2, [r0, #4]
    movs r2, #7
    str r2, [r0, #-4]
    // Once only: the next round is far away.
    ldr r6, =0xFFFFFF
    str r6, [r0]
    str r5, [r11], #4
    str r4, [r3]
    nop
    nop
    nop
    nop
    ldr r0, =0xE000E010
    movs r2, #0
    str r2, [r0]
    b done

function svc_handler
    entered 0x5C
    ldr r0, =SCENARIO
    ldr r0, [r0]
    cmp r0, #3
    bne 1f
    mrs r1, psp
    trace_reg r1
1:  cmp r0, #11
    bne 2f
    mvn lr, #0xB
    bx lr
2:  cmp r0, #16
    bne 3f
    mov r1, sp
    and r1, #7
    trace_reg r1
    ldr r1, [sp, #28]
    lsr r1, #9
    and r1, #1
    trace_reg r1
3:  cmp r0, #25
    bne 4f
    push {r0, lr}
    poke ICSR, 1 << 28
    pop {r0, lr}
4:  trace 0x5E
    bx lr

function irq0_handler
    entered 0x10
    push {r0, lr}
    ldr r0, =SCENARIO
    ldr r0, [r0]
    cmp r0, #1
    it ne
    cmpne r0, #28
    bne 1f
    poke ISPR, 2
    nop
1:  trace 0x1E
    pop {r0, pc}

function irq1_handler
    entered 0x11
    trace 0x1F
    bx lr

function irq2_handler
    entered 0x12
    mov r1, sp
    trace_reg r1
    bx lr

function irq3_handler
    entered 0x13
    ldr r1, [r11, #-24]
    ldr r2, =0x13
    cmp r1, r2
    beq 1f
    poke ISPR, 8
1:  bx lr

function pendsv_handler
    entered 0x9E
    bx lr

function systick_handler
    entered 0x57
    bx lr

function usagefault_handler
    entered 0x6F
    ldr r0, =CFSR
    ldr r1, [r0]
    trace_reg r1
    str r1, [r0]
    // Step over the faulting instruction, by its size.
    mrs r0, msp
    ldr r1, [r0, #24]
    ldr r2, =SCENARIO
    ldr r2, [r2]
    cmp r2, #22
    beq 2f
    cmp r2, #11
    beq 3f
    ldrh r2, [r1]
    lsrs r2, #11
    add r1, #2
    cmp r2, #0x1D
    it hs
    addhs r1, #2
    str r1, [r0, #24]
    bx lr
2:  // The interrupted state was ARM: set the Thumb bit again.
    ldr r2, [r0, #28]
    and r3, r2, #1 << 24
    trace_reg r3
    orr r2, #1 << 24
    str r2, [r0, #28]
    bx lr
3:  mvn lr, #6
    bx lr

function busfault_handler
    entered 0xBF
    ldr r0, =CFSR
    ldr r1, [r0]
    trace_reg r1
    ldr r1, [r0, #0x10]
    trace_reg r1
    skip_instruction 4
    // Unprivileged code goes on as privileged.
    movs r1, #0
    msr control, r1
    bx lr

function hardfault_handler
    entered 0xF0
    ldr r0, =HFSR
    ldr r1, [r0]
    trace_reg r1
    ldr r0, =SCENARIO
    ldr r0, [r0]
    cmp r0, #15
    it eq
    udfeq #2
    cmp r0, #17
    beq 1f
    skip_instruction 2
    bx lr
1:  skip_instruction 2
    bx lr
