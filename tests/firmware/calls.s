@ Each loads the second virtual function of its argument, and may call another one all the same.
.syntax unified
.thumb
.macro function name
.global \name
.type \name, %function
.thumb_func
\name:
  push {r4, lr}
  ldr r3, [r0]
.endm

function meets_at_a_label
  cbz r1, 1f
  ldr r3, [r3]
  b 2f
1:ldr r3, [r3, #4]
2:blx r3
  pop {r4, pc}

function overwritten
  ldr r3, [r3, #4]
  mov r3, r1
  blx r3
  pop {r4, pc}

function after_a_call
  ldr r3, [r3, #4]
  bl take
  blx r3
  pop {r4, pc}

function behind_a_table
  ldr r2, [r3]
  tbb [pc, r1]
1:.byte (2f - 1b) / 2, (3f - 1b) / 2
2:ldr r2, [r0]
  ldr r2, [r2, #4]
3:blx r2
  pop {r4, pc}
