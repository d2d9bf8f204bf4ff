/* A program that uses the whole board with one protocol, FLASH_PROTOCOL, so that the linker shows
 * what it takes. Its texts for people are left out, as in a board without a console. */
#include "board.h"

#include "berth/drive_cia402.h"
#include "berth/drive_odrive.h"
#include "berth/drive_vesc.h"
#include "berth/link.h"

static berth_board_t board;
static berth_link_t link;
static berth_plan_t plan;
static berth_board_config_t config;
static berth_pose_t pose;
static berth_can_t can;
static berth_refusal_t refusal;

int main(void) {
    int failed = 0;
    __asm volatile("" : "+m"(plan), "+m"(config), "+m"(pose), "+m"(can));
    config.drives[0].protocol = &FLASH_PROTOCOL;
    config.drives[1].protocol = &FLASH_PROTOCOL;
    failed += berth_board_init(&board, &plan, &config, 0, &refusal) != BERTH_OK;
    failed += berth_board_set_pose(&board, &pose, 0) != BERTH_OK;
    berth_link_init(&link, &board, &can);
    while (board_now_us() < berth_link_deadline(&link)) {
        berth_link_run(&link, board_now_us());
    }
    return failed;
}
