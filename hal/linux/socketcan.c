#include "socketcan.h"

#include "realtime.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/netlink.h>
#include <linux/can/raw.h>
#include <linux/net_tstamp.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define NS_PER_US 1000
#define US_PER_S 1000000

_Static_assert(SOCKETCAN_NAME_MAX + 1u == IFNAMSIZ, "the kernel's names have this length");
_Static_assert(SOCKETCAN_FILTERS_MAX + SOCKETCAN_SENT_IDS_MAX <= CAN_RAW_FILTER_MAX,
               "all filters fit one socket");
_Static_assert(BERTH_CAN_EXTENDED_MAX == CAN_EFF_MASK && BERTH_CAN_STANDARD_MAX == CAN_SFF_MASK,
               "ids are the kernel's");

static void count(uint32_t *counter, uint32_t more) {
    *counter = more > UINT32_MAX - *counter ? UINT32_MAX : *counter + more;
}

/* Closes and keeps errno, which says why. */
static void close_quietly(int *fd) {
    const int kept = errno;
    if (*fd >= 0) {
        (void)close(*fd);
    }
    *fd = -1;
    errno = kept;
}

/* ---- Filters -----------------------------------------------------------------------------------
 */

/* Formats are told apart by the kernel, remote frames are let through for the reader to count. */
static struct can_filter kernel_filter(const berth_can_filter_t *filter) {
    const uint32_t all = filter->extended ? CAN_EFF_MASK : CAN_SFF_MASK;
    return (struct can_filter){.can_id =
                                   (filter->id & all) | (filter->extended ? CAN_EFF_FLAG : 0u),
                               .can_mask = (filter->mask & all) | CAN_EFF_FLAG};
}

static struct can_filter exact_filter(uint32_t can_id) {
    const uint32_t all = (can_id & CAN_EFF_FLAG) != 0u ? CAN_EFF_MASK : CAN_SFF_MASK;
    return (struct can_filter){.can_id = can_id & (all | CAN_EFF_FLAG),
                               .can_mask = all | CAN_EFF_FLAG};
}

static bool passes(const struct can_filter *filter, uint32_t can_id) {
    return (can_id & filter->can_mask) == (filter->can_id & filter->can_mask);
}

static bool wanted(const socketcan_t *bus, uint32_t can_id) {
    bool good = bus->filter_count == 0u;
    for (uint32_t i = 0; i < bus->filter_count && !good; i++) {
        const struct can_filter filter = kernel_filter(&bus->filters[i]);
        good = passes(&filter, can_id);
    }
    return good;
}

static bool set_filters(const socketcan_t *bus, int fd) {
    struct can_filter list[SOCKETCAN_FILTERS_MAX + SOCKETCAN_SENT_IDS_MAX];
    uint32_t length = 0;
    if (bus->filter_count == 0u) {
        list[length++] = (struct can_filter){0, 0};
    }
    for (uint32_t i = 0; i < bus->filter_count; i++) {
        list[length++] = kernel_filter(&bus->filters[i]);
    }
    for (uint32_t i = 0; i < bus->sent_id_count && bus->filter_count > 0u; i++) {
        list[length++] = exact_filter(bus->sent_ids[i]);
    }
    return setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, list,
                      (socklen_t)(length * sizeof list[0])) == 0;
}

/* Echoes come through the same filter: true if this id's do. */
static bool tracked(socketcan_t *bus, uint32_t can_id) {
    const uint32_t id = exact_filter(can_id).can_id;
    if (wanted(bus, id)) {
        return true;
    }
    for (uint32_t i = 0; i < bus->sent_id_count; i++) {
        if (bus->sent_ids[i] == id) {
            return true;
        }
    }
    if (bus->sent_id_count == SOCKETCAN_SENT_IDS_MAX) {
        return false;
    }
    bus->sent_ids[bus->sent_id_count++] = id;
    if (!set_filters(bus, bus->fd)) {
        bus->sent_id_count--;
        return false;
    }
    return true;
}

/* ---- The socket --------------------------------------------------------------------------------
 */

static void set_flag(int fd, int level, int option) {
    const int on = 1;
    (void)setsockopt(fd, level, option, &on, sizeof on);
}

static void ask_for_stamps(int fd) {
    const int flags = SOF_TIMESTAMPING_RX_HARDWARE | SOF_TIMESTAMPING_RAW_HARDWARE |
                      SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE;
    if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPING, &flags, sizeof flags) != 0) {
        set_flag(fd, SOL_SOCKET, SO_TIMESTAMPNS);
    }
}

/* What must work for the promises of the header, and what may be missing. */
static bool set_options(const socketcan_t *bus, int fd) {
    const can_err_mask_t all_errors = CAN_ERR_MASK;
    const int on = 1;
    ask_for_stamps(fd);
    set_flag(fd, SOL_SOCKET, SO_RXQ_OVFL);
    return setsockopt(fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &all_errors, sizeof all_errors) == 0 &&
           setsockopt(fd, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &on, sizeof on) == 0 &&
           set_filters(bus, fd);
}

static bool interface_request(int fd, const char *name, unsigned long what, struct ifreq *request) {
    memset(request, 0, sizeof *request);
    (void)snprintf(request->ifr_name, sizeof request->ifr_name, "%s", name);
    return ioctl(fd, what, request) == 0;
}

/* 0, or the errno that says why not. *up is told when 0. */
static int open_socket(socketcan_t *bus, bool *up) {
    struct ifreq request;
    int fd = socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
    if (fd < 0) {
        return errno;
    }
    int cause = 0;
    struct sockaddr_can address = {.can_family = AF_CAN};
    if (!interface_request(fd, bus->name, SIOCGIFINDEX, &request)) {
        cause = errno;
    } else {
        address.can_ifindex = request.ifr_ifindex;
        if (!set_options(bus, fd) || bind(fd, (struct sockaddr *)&address, sizeof address) != 0) {
            cause = errno;
        }
    }
    *up = cause == 0 && interface_request(fd, bus->name, SIOCGIFFLAGS, &request) &&
          (request.ifr_flags & IFF_UP) != 0;
    if (cause != 0) {
        close_quietly(&fd);
        return cause;
    }
    bus->fd = fd;
    bus->interface_index = (uint32_t)address.can_ifindex;
    count(&bus->statistics.opened, 1u);
    return 0;
}

/* ---- Down and up -------------------------------------------------------------------------------
 */

/* What is in flight will not be confirmed any more. */
static void give_up_flight(socketcan_t *bus) {
    count(&bus->counters.tx_dropped, bus->flight_count);
    bus->flight_count = 0;
}

static void go_down(socketcan_t *bus, int cause) {
    bus->statistics.last_errno = cause;
    if (!bus->down) {
        bus->down = true;
        bus->retry_us = realtime_now_us() + SOCKETCAN_RETRY_US;
        give_up_flight(bus);
    }
}

static void come_up(socketcan_t *bus) {
    bus->down = false;
    bus->off = false;
    bus->passive = false;
    bus->overflow = 0;
    bus->stamps.set = false;
    count(&bus->counters.restarts, 1u);
}

/* The old socket has lost its filters if the interface was deleted: a new one is simplest. */
static void look_for_interface(socketcan_t *bus, int64_t now_us) {
    if (now_us < bus->retry_us) {
        return;
    }
    bus->retry_us = now_us + SOCKETCAN_RETRY_US;
    bool up = false;
    close_quietly(&bus->fd);
    const int cause = open_socket(bus, &up);
    if (cause != 0) {
        bus->statistics.last_errno = cause;
    } else if (up) {
        come_up(bus);
    } else {
        bus->statistics.last_errno = ENETDOWN;
        close_quietly(&bus->fd);
    }
}

/* ---- Bus-off -----------------------------------------------------------------------------------
 */

typedef struct {
    struct nlmsghdr header;
    struct ifinfomsg link;
    struct rtattr info;
    struct rtattr kind;
    char kind_text[4];
    struct rtattr data;
    struct rtattr restart;
    uint32_t restart_value;
} restart_request_t;

static restart_request_t restart_request(uint32_t interface_index) {
    restart_request_t request = {.kind_text = "can"};
    request.header.nlmsg_len = sizeof request;
    request.header.nlmsg_type = RTM_NEWLINK;
    request.header.nlmsg_flags = NLM_F_REQUEST | NLM_F_ACK;
    request.link.ifi_family = AF_UNSPEC;
    request.link.ifi_index = (int)interface_index;
    request.info.rta_type = IFLA_LINKINFO;
    request.info.rta_len = sizeof request - offsetof(restart_request_t, info);
    request.kind.rta_type = IFLA_INFO_KIND;
    request.kind.rta_len = sizeof request.kind + sizeof request.kind_text;
    request.data.rta_type = IFLA_INFO_DATA;
    request.data.rta_len = sizeof request - offsetof(restart_request_t, data);
    request.restart.rta_type = IFLA_CAN_RESTART;
    request.restart.rta_len = sizeof request.restart + sizeof request.restart_value;
    request.restart_value = 1u;
    return request;
}

_Static_assert(sizeof(restart_request_t) ==
                   sizeof(struct nlmsghdr) + sizeof(struct ifinfomsg) + 24u,
               "attributes follow each other without gaps");

/* The kernel answers before send returns, so that the answer is there to be read. */
static int ask_kernel(int fd, const restart_request_t *request) {
    struct {
        struct nlmsghdr header;
        struct nlmsgerr error;
        char rest[256];
    } answer;
    if (send(fd, request, sizeof *request, 0) < 0) {
        return errno;
    }
    const ssize_t got = recv(fd, &answer, sizeof answer, MSG_DONTWAIT);
    if (got < 0) {
        return errno;
    }
    if ((size_t)got < sizeof answer.header + sizeof answer.error ||
        answer.header.nlmsg_type != NLMSG_ERROR) {
        return EPROTO;
    }
    return -answer.error.error;
}

/* 0, or why the interface was not restarted. */
static int restart_interface(uint32_t interface_index) {
    int fd = socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE);
    if (fd < 0) {
        return errno;
    }
    const restart_request_t request = restart_request(interface_index);
    const int cause = ask_kernel(fd, &request);
    close_quietly(&fd);
    return cause;
}

static void leave_off(socketcan_t *bus) {
    if (bus->off) {
        count(&bus->counters.restarts, 1u);
    }
    bus->off = false;
    bus->passive = false;
}

static void enter_off(socketcan_t *bus, int64_t now_us) {
    bus->off_us = now_us;
    if (!bus->off) {
        bus->restart_us = now_us + SOCKETCAN_RESTART_FIRST_US;
        give_up_flight(bus);
    }
    bus->off = true;
}

static void ask_for_restart(socketcan_t *bus, int64_t now_us) {
    bus->restart_us = now_us + SOCKETCAN_RESTART_US;
    count(&bus->statistics.restarts_asked, 1u);
    bus->statistics.restart_errno = restart_interface(bus->interface_index);
}

bool socketcan_restart(socketcan_t *bus) {
    if (!bus->off || bus->down) {
        return false;
    }
    ask_for_restart(bus, realtime_now_us());
    if (bus->statistics.restart_errno == EOPNOTSUPP) {
        leave_off(bus);
        return true;
    }
    return bus->statistics.restart_errno == 0;
}

/* ---- Frames in flight --------------------------------------------------------------------------
 */

static socketcan_slot_t *slot_at(socketcan_t *bus, uint32_t index) {
    return &bus->flight[(bus->flight_at + index) % SOCKETCAN_IN_FLIGHT_MAX];
}

static void take_slot(socketcan_t *bus, uint32_t can_id, int64_t now_us) {
    *slot_at(bus, bus->flight_count) = (socketcan_slot_t){can_id, bus->overflow, now_us};
    bus->flight_count++;
}

/* The newest one, after a send that failed. */
static void give_back_slot(socketcan_t *bus) {
    bus->flight_count--;
}

static void give_up_oldest(socketcan_t *bus) {
    if (slot_at(bus, 0)->overflow == bus->overflow) {
        count(&bus->counters.tx_dropped, 1u);
    } else {
        count(&bus->statistics.unknown, 1u);
    }
    bus->flight_at = (bus->flight_at + 1u) % SOCKETCAN_IN_FLIGHT_MAX;
    bus->flight_count--;
}

static void give_up_late(socketcan_t *bus, int64_t now_us) {
    while (bus->flight_count > 0u && now_us - slot_at(bus, 0)->sent_us > SOCKETCAN_CONFIRM_US) {
        give_up_oldest(bus);
    }
}

/* Frames go out in order, so the first is the one, unless an echo was lost. */
static void confirm(socketcan_t *bus, uint32_t can_id) {
    uint32_t index = 0;
    while (index < bus->flight_count && slot_at(bus, index)->id != can_id) {
        index++;
    }
    if (index == bus->flight_count) {
        count(&bus->statistics.late, 1u);
        return;
    }
    for (; index > 0u; index--) {
        *slot_at(bus, index) = *slot_at(bus, index - 1u);
    }
    bus->flight_at = (bus->flight_at + 1u) % SOCKETCAN_IN_FLIGHT_MAX;
    bus->flight_count--;
    count(&bus->statistics.confirmed, 1u);
}

/* ---- Error frames ------------------------------------------------------------------------------
 */

static void count_class(uint32_t *counter, uint32_t classes, uint32_t which) {
    if ((classes & which) != 0u) {
        count(counter, 1u);
    }
}

static void take_controller(socketcan_t *bus, uint8_t status) {
    if ((status & CAN_ERR_CRTL_RX_OVERFLOW) != 0u) {
        count(&bus->counters.rx_lost, 1u);
    }
    if ((status & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0u) {
        bus->passive = true;
    } else if ((status &
                (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING | CAN_ERR_CRTL_ACTIVE)) != 0u) {
        bus->passive = false;
    }
}

static void take_error(socketcan_t *bus, const struct can_frame *frame, int64_t now_us) {
    const uint32_t classes = frame->can_id & CAN_ERR_MASK;
    socketcan_errors_t *errors = &bus->statistics.errors;
    count(&bus->counters.error_frames, 1u);
    count_class(&errors->tx_timeout, classes, CAN_ERR_TX_TIMEOUT);
    count_class(&errors->lost_arbitration, classes, CAN_ERR_LOSTARB);
    count_class(&errors->controller, classes, CAN_ERR_CRTL);
    count_class(&errors->protocol, classes, CAN_ERR_PROT);
    count_class(&errors->transceiver, classes, CAN_ERR_TRX);
    count_class(&errors->no_acknowledge, classes, CAN_ERR_ACK);
    count_class(&errors->bus_off, classes, CAN_ERR_BUSOFF);
    count_class(&errors->bus_error, classes, CAN_ERR_BUSERROR);
    count_class(&errors->restarted, classes, CAN_ERR_RESTARTED);
    if ((classes & CAN_ERR_CNT) != 0u) {
        bus->statistics.tx_errors = frame->data[6];
        bus->statistics.rx_errors = frame->data[7];
    }
    if ((classes & CAN_ERR_CRTL) != 0u) {
        take_controller(bus, frame->data[1]);
    }
    if ((classes & CAN_ERR_RESTARTED) != 0u) {
        leave_off(bus);
    }
    if ((classes & CAN_ERR_BUSOFF) != 0u) {
        enter_off(bus, now_us);
    }
}

/* ---- Receive -----------------------------------------------------------------------------------
 */

typedef struct {
    struct can_frame frame;
    size_t length;
    int flags;
    int64_t wall_us; /* 0: not stamped */
    int64_t adapter_us;
} message_t;

static int64_t us_of(const struct timespec *time) {
    return (int64_t)time->tv_sec * US_PER_S + time->tv_nsec / NS_PER_US;
}

static int64_t wall_us(void) {
    struct timespec now;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    return us_of(&now);
}

/* Messages that found no room since the last one that did; the kernel's count wraps. */
static void take_overflow(socketcan_t *bus, uint32_t now) {
    count(&bus->counters.rx_lost, now - bus->overflow);
    bus->overflow = now;
}

static void take_control(socketcan_t *bus, const struct cmsghdr *item, message_t *message) {
    if (item->cmsg_level != SOL_SOCKET) {
        return;
    }
    if (item->cmsg_type == SO_RXQ_OVFL) {
        uint32_t lost = 0;
        memcpy(&lost, CMSG_DATA(item), sizeof lost);
        take_overflow(bus, lost);
    } else if (item->cmsg_type == SCM_TIMESTAMPING) {
        struct timespec stamps[3]; /* software, obsolete, the adapter's own */
        memcpy(stamps, CMSG_DATA(item), sizeof stamps);
        message->wall_us = us_of(&stamps[0]);
        message->adapter_us = us_of(&stamps[2]);
    } else if (item->cmsg_type == SCM_TIMESTAMPNS) {
        struct timespec stamp;
        memcpy(&stamp, CMSG_DATA(item), sizeof stamp);
        message->wall_us = us_of(&stamp);
    }
}

/* 0, or errno. */
static int read_message(socketcan_t *bus, message_t *message) {
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(3 * sizeof(struct timespec)) + CMSG_SPACE(sizeof(struct timespec)) +
                   CMSG_SPACE(sizeof(uint32_t))];
    } control;
    memset(message, 0, sizeof *message);
    struct iovec part = {.iov_base = &message->frame, .iov_len = sizeof message->frame};
    struct msghdr header = {.msg_iov = &part,
                            .msg_iovlen = 1,
                            .msg_control = &control,
                            .msg_controllen = sizeof control};
    /* NOLINTNEXTLINE(clang-analyzer-unix.StdCLibraryFunctions): the bus is open */
    const ssize_t got = recvmsg(bus->fd, &header, 0);
    if (got < 0) {
        return errno;
    }
    message->length = (size_t)got;
    message->flags = header.msg_flags;
    for (struct cmsghdr *item = CMSG_FIRSTHDR(&header); item != NULL;
         item = CMSG_NXTHDR(&header, item)) {
        take_control(bus, item, message);
    }
    return 0;
}

static int64_t stamp_of(socketcan_t *bus, const message_t *message, int64_t now_us) {
    int64_t time_us = now_us;
    if (message->wall_us != 0) {
        time_us = stamp_from_wall(message->wall_us, wall_us(), now_us);
    }
    bus->statistics.hardware_stamps = message->adapter_us != 0;
    if (message->adapter_us != 0) {
        time_us = stamp_from_adapter(&bus->stamps, message->adapter_us, time_us);
    }
    if (time_us < bus->last_us) {
        time_us = bus->last_us;
    }
    bus->last_us = time_us;
    return time_us;
}

static bool well_formed(const message_t *message) {
    return message->length == sizeof message->frame && (message->flags & MSG_TRUNC) == 0 &&
           message->frame.can_dlc <= CAN_MAX_DLEN;
}

static berth_can_frame_t frame_of(const struct can_frame *from, int64_t time_us) {
    berth_can_frame_t frame = {.time_us = time_us,
                               .extended = (from->can_id & CAN_EFF_FLAG) != 0u,
                               .remote = (from->can_id & CAN_RTR_FLAG) != 0u,
                               .length = from->can_dlc};
    frame.id = from->can_id & (frame.extended ? CAN_EFF_MASK : CAN_SFF_MASK);
    if (!frame.remote) {
        memcpy(frame.data, from->data, frame.length);
    }
    return frame;
}

/* A frame from the bus while it is reported off. True: it came so late that the report is wrong. */
static bool back_on_bus(socketcan_t *bus, int64_t now_us) {
    if (now_us - bus->off_us < SOCKETCAN_STALE_US) {
        count(&bus->statistics.discarded, 1u);
        return false;
    }
    leave_off(bus);
    return true;
}

/* True: a frame to hand out. */
static bool take_message(socketcan_t *bus, const message_t *message, berth_can_frame_t *frame) {
    const int64_t now_us = realtime_now_us();
    const struct can_frame *got = &message->frame;
    if (!well_formed(message)) {
        count(&bus->statistics.malformed, 1u);
        return false;
    }
    if ((got->can_id & CAN_ERR_FLAG) != 0u) {
        take_error(bus, got, now_us);
        return false;
    }
    if ((message->flags & MSG_CONFIRM) != 0) {
        confirm(bus, got->can_id);
        return false;
    }
    if (bus->off && !back_on_bus(bus, now_us)) {
        return false;
    }
    if (!wanted(bus, got->can_id)) {
        count(&bus->statistics.foreign, 1u);
        return false;
    }
    *frame = frame_of(got, stamp_of(bus, message, now_us));
    count(&bus->statistics.received, 1u);
    return true;
}

/* ---- The bus -----------------------------------------------------------------------------------
 */

static bool would_block(int cause) {
    return cause == EAGAIN || cause == EWOULDBLOCK || cause == ENOBUFS || cause == EINTR;
}

static void maintain(socketcan_t *bus) {
    if (bus->down) {
        look_for_interface(bus, realtime_now_us());
    } else if (bus->off) {
        const int64_t now_us = realtime_now_us();
        if (now_us >= bus->restart_us) {
            ask_for_restart(bus, now_us);
        }
    }
}

static bool valid(const berth_can_frame_t *frame) {
    const uint32_t max = frame->extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
    return frame->id <= max && frame->length <= BERTH_CAN_DATA_MAX;
}

static struct can_frame kernel_frame(const berth_can_frame_t *from) {
    struct can_frame frame = {.can_id = from->id, .can_dlc = from->length};
    frame.can_id |= from->extended ? CAN_EFF_FLAG : 0u;
    frame.can_id |= from->remote ? CAN_RTR_FLAG : 0u;
    if (!from->remote) {
        memcpy(frame.data, from->data, from->length);
    }
    return frame;
}

/* In flight before it is written, given back if it is not taken. */
static berth_can_outcome_t write_frame(socketcan_t *bus, const struct can_frame *frame,
                                       bool with_slot) {
    if (with_slot) {
        take_slot(bus, frame->can_id, realtime_now_us());
    }
    if (write(bus->fd, frame, sizeof *frame) == (ssize_t)sizeof *frame) {
        count(&bus->statistics.sent, 1u);
        if (!with_slot) {
            count(&bus->statistics.untracked, 1u);
        }
        return BERTH_CAN_DONE;
    }
    const int cause = errno;
    if (with_slot) {
        give_back_slot(bus);
    }
    if (would_block(cause)) {
        count(&bus->statistics.queue_full, 1u);
        return BERTH_CAN_AGAIN;
    }
    go_down(bus, cause);
    return BERTH_CAN_FAILED;
}

static berth_can_outcome_t bus_send(void *context, const berth_can_frame_t *frame) {
    socketcan_t *bus = context;
    if (!valid(frame)) {
        count(&bus->statistics.refused, 1u);
        return BERTH_CAN_FAILED;
    }
    maintain(bus);
    if (bus->down || bus->off) {
        return BERTH_CAN_FAILED;
    }
    give_up_late(bus, realtime_now_us());
    if (bus->flight_count == SOCKETCAN_IN_FLIGHT_MAX) {
        count(&bus->statistics.queue_full, 1u);
        return BERTH_CAN_AGAIN;
    }
    const struct can_frame out = kernel_frame(frame);
    return write_frame(bus, &out, tracked(bus, out.can_id));
}

static berth_can_outcome_t bus_receive(void *context, berth_can_frame_t *frame) {
    socketcan_t *bus = context;
    maintain(bus);
    for (uint32_t read = 0; !bus->down && read < SOCKETCAN_RECEIVE_MAX; read++) {
        message_t message;
        const int cause = read_message(bus, &message);
        if (cause == EAGAIN || cause == EWOULDBLOCK || cause == EINTR) {
            break;
        }
        if (cause != 0) {
            go_down(bus, cause);
        } else if (take_message(bus, &message, frame)) {
            return BERTH_CAN_DONE;
        }
    }
    return bus->down || bus->off ? BERTH_CAN_FAILED : BERTH_CAN_AGAIN;
}

static berth_can_mode_t mode_of(const socketcan_t *bus) {
    if (bus->down) {
        return BERTH_CAN_DOWN;
    }
    if (bus->off) {
        return BERTH_CAN_BUS_OFF;
    }
    return bus->passive ? BERTH_CAN_ERROR_PASSIVE : BERTH_CAN_ERROR_ACTIVE;
}

static void bus_state(void *context, berth_can_state_t *state) {
    socketcan_t *bus = context;
    maintain(bus);
    give_up_late(bus, realtime_now_us());
    *state = bus->counters;
    state->mode = mode_of(bus);
}

/* ---- Opening -----------------------------------------------------------------------------------
 */

static bool fail(char *error, size_t error_size, const char *name, const char *why) {
    (void)snprintf(error, error_size, "socketcan: interface '%.40s': %s", name, why);
    return false;
}

static const char *why_not(const char *name, int cause) {
    switch (cause) {
    case EAFNOSUPPORT:
    case EPROTONOSUPPORT:
        return "this kernel has no CAN (modules can and can_raw)";
    case ENODEV:
        return if_nametoindex(name) != 0u
                   ? "not a CAN interface"
                   : "no such interface (make it with ip link, or plug it in)";
    default:
        return strerror(cause);
    }
}

static bool check(const char *name, const berth_can_filter_t *filters, uint32_t filter_count,
                  char *error, size_t error_size) {
    const size_t length = strlen(name);
    if (length == 0u || length > SOCKETCAN_NAME_MAX) {
        return fail(error, error_size, name, "a name has 1 to 15 characters");
    }
    if (filter_count > SOCKETCAN_FILTERS_MAX || (filters == NULL && filter_count > 0u)) {
        return fail(error, error_size, name, "0 to 64 filters are allowed");
    }
    for (uint32_t i = 0; i < filter_count; i++) {
        const uint32_t max = filters[i].extended ? BERTH_CAN_EXTENDED_MAX : BERTH_CAN_STANDARD_MAX;
        if (filters[i].id > max) {
            return fail(error, error_size, name, "a filter's id is out of its format's range");
        }
    }
    return true;
}

bool socketcan_open(socketcan_t *bus, const char *name, const berth_can_filter_t *filters,
                    uint32_t filter_count, char *error, size_t error_size) {
    memset(bus, 0, sizeof *bus);
    bus->fd = -1;
    bus->down = true;
    bus->retry_us = INT64_MAX;
    if (!check(name, filters, filter_count, error, error_size)) {
        return false;
    }
    memcpy(bus->name, name, strlen(name) + 1u);
    if (filter_count > 0u) {
        memcpy(bus->filters, filters, filter_count * sizeof *filters);
    }
    bus->filter_count = filter_count;
    bool up = false;
    const int cause = open_socket(bus, &up);
    if (cause != 0) {
        return fail(error, error_size, name, why_not(name, cause));
    }
    bus->down = !up;
    bus->retry_us = 0;
    return true;
}

berth_can_t socketcan_can(socketcan_t *bus) {
    static const berth_can_api_t api = {bus_send, bus_receive, bus_state};
    return (berth_can_t){&api, bus};
}

int socketcan_fd(const socketcan_t *bus) {
    return bus->down ? -1 : bus->fd;
}

socketcan_statistics_t socketcan_statistics(const socketcan_t *bus) {
    return bus->statistics;
}

void socketcan_close(socketcan_t *bus) {
    close_quietly(&bus->fd);
    bus->down = true;
    bus->retry_us = INT64_MAX;
}
