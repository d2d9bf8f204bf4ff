/* Everything of the firmware in one image, by the linker's order, with no C library's streams: what
 * a product may hold at most. test_images.py looks at it. */
#include "board.h"

int main(void) {
    board_puts("whole\n");
    return 0;
}
